//! The form of a scene that a simulation needs: everything in grid units, z up.

use super::bodies::{in_grid_units, in_metres};
use super::motion::Recording;
use super::plausible::doubts;
use super::points::{norm, zip};
use super::script::Change;
use super::surface::Sheet;
use super::{Airflow, BodyPose, Handles, MapFile, Motion, Scene, Start, Units, UpAxis};
use crate::cloth::{
    Cloth, Control, Embedding, Grid, Intersection, Model, Pose, State, Sweep, VertexView, cast,
    intersections, untangle,
};
use crate::io::{Embedded, Frames, MeshFile, RenderMesh, Topology, Trajectory};
use crate::{Error, Result, memory};
use glam::DVec3;
use num_traits::Float;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::RangeInclusive;
use std::sync::{Arc, Mutex, PoisonError};

/// The most frames that a scene may ask for: far above any use, well within memory.
pub const MAX_FRAMES: usize = 1_000_000;
/// The most handle positions, likewise.
const MAX_HANDLE_POSITIONS: usize = 50_000_000;
/// Bytes that a scene takes per particle while it is set up: points, start and cloth.
const BYTES_PER_PARTICLE: usize = 200;
/// Spacing of single-precision numbers \[edges\] above which the cloth's distance from the origin harms its
/// frames.
const COARSEST: f64 = 1e-3;
/// Mean lengths of a start's edges \[edges\] that need no warning: folds and wrinkles do not change edge
/// lengths.
const USUAL: RangeInclusive<f64> = 0.9..=1.1;
/// Default number of frames of a scene whose handles do not move: as many as the built-in motions have at
/// 1/60 s.
const STILL_FRAMES: usize = 391;

/// Warns, unless the process has already said so.
pub(super) fn warn_once(message: String) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    // Released before the subscriber runs, which may set up scenes of its own.
    let is_new = SAID.lock().unwrap_or_else(PoisonError::into_inner).insert(message.clone());
    if is_new {
        tracing::warn!("{message}");
    }
}

/// A scene ready to simulate: one cloth in grid units, z up, and the conversion back to SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The grid and the constants of the one cloth.
    pub model: Model,
    /// The start state, at frame 0.
    pub start: State<f64>,
    /// Handle positions \[edges\] for each frame, including the start, shape `[frames][handles]`.
    pub handles: Vec<Vec<[f64; 3]>>,
    /// The body that each handle follows, if it follows one, shape `[handles]`; `handles` has where the scene moves it with that.
    pub attached: Vec<Option<usize>>,
    /// Poses of each body in each frame, including the start: a single one if it does not move; past the last one it
    /// stays there. Shape `[bodies][frames]`.
    pub poses: Vec<Vec<Pose>>,
    /// What changes on the way, in the order of time. The fields above are those of the start.
    pub changes: Vec<Change>,
    /// The wind.
    pub wind: Airflow,
    /// Size of the grid units in SI units.
    pub units: Units,
    /// The axis that points up in the scene.
    pub up: UpAxis,
    /// The mesh that the cloth carries along, if it isn't the grid's own.
    pub embedding: Option<Arc<EmbeddedMesh>>,
}

/// A mesh that a cloth carries along.
#[derive(Clone, Debug, PartialEq)]
pub struct EmbeddedMesh {
    /// The mesh.
    pub mesh: RenderMesh,
    /// Where in the cloth its vertices are.
    pub embedding: Embedding,
}

impl EmbeddedMesh {
    /// Returns the frames of the mesh, from those of the particles. Panics if these are of another number of particles.
    pub fn frames<'a>(&'a self, of_particles: &'a dyn Frames) -> Embedded<'a> {
        Embedded::new(of_particles, self.mesh.topology(), &self.embedding)
    }
}

/// Several cloths on one grid, ready to advance together.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// The grid and the constants of the B cloths.
    pub model: Model,
    /// The start states, at frame 0.
    pub start: State<f64>,
    /// Handle positions \[edges\] for each frame: all handles of cloth 0, then of cloth 1, and so on. There
    /// are as many frames as the longest cloth has; the others' handles keep their last positions.
    pub handles: Vec<Vec<[f64; 3]>>,
    /// Poses of the bodies of all cloths, as in [`Setup::poses`]: all bodies of cloth 0, then of cloth 1, and so on.
    pub poses: Vec<Vec<Pose>>,
    /// The wind of each cloth, shape `[B]`.
    pub wind: Vec<Airflow>,
    /// Units of each cloth, shape `[B]`.
    pub units: Vec<Units>,
    /// The axis that points up in each cloth's scene, shape `[B]`.
    pub up: Vec<UpAxis>,
}

/// Maps each point of a field of shape [3, H, W], such as positions or velocities, with `f`. Panics if the
/// field is not that of one cloth on the grid.
fn each_point<T: Float>(grid: Grid, field: &[T], f: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<[f64; 3]> {
    let n = grid.particles();
    assert_eq!(field.len(), 3 * n, "a field of one cloth, [3, H, W]");
    (0..n).map(|p| f([p, n + p, 2 * n + p].map(|k| cast(field[k])))).collect()
}

/// Converts points in particle order into a field of shape [3, H, W].
fn field(points: &[[f64; 3]]) -> Vec<f64> {
    (0..3).flat_map(|c| points.iter().map(move |p| p[c])).collect()
}

/// Returns the view in which vertices are in metres along a scene's axes, at the end of the frame.
fn view_m(units: &Units, up: UpAxis) -> VertexView {
    let columns =
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| up.from_z_up(units.position_m(axis)));
    let transform = [0, 1, 2].map(|row| {
        let [a, b, c] = columns.map(|column| column[row] as f32);
        [a, b, c, 0.0]
    });
    VertexView { transform, ..Default::default() }
}

/// Returns the control of a frame; past the end, the handles keep their last positions, and bodies their last poses.
fn control<T: Float>(
    handles: &[Vec<[f64; 3]>],
    poses: &[Vec<Pose>],
    wind: &[Airflow],
    frame: usize,
) -> Control<T> {
    let row = handles.get(frame).or(handles.last()).map_or(&[][..], Vec::as_slice);
    Control {
        handles: row.iter().map(|p| p.map(cast)).collect(),
        wind: wind.iter().map(|w| w.at(frame).map(cast)).collect(),
        external: Vec::new(),
        bodies: sweeps(poses, frame),
    }
}

/// Returns the pose of a body in a frame; past the last one it stays there.
fn pose(poses: &[Pose], frame: usize) -> Pose {
    poses[frame.min(poses.len() - 1)]
}

/// Returns how the bodies move in the step that ends at `frame`; nothing if none of them ever moves.
pub(super) fn sweeps(poses: &[Vec<Pose>], frame: usize) -> Vec<Sweep> {
    let sweep =
        |poses: &Vec<Pose>| Sweep { from: pose(poses, frame.saturating_sub(1)), to: pose(poses, frame) };
    match poses.iter().all(|poses| poses.len() == 1) {
        true => Vec::new(),
        false => poses.iter().map(sweep).collect(),
    }
}

/// Reads a mesh and places it in the cloth.
fn embed(file: &MeshFile, grid: Grid, cloth: &Cloth) -> Result<EmbeddedMesh> {
    let mesh = RenderMesh::read(file.clone())?;
    let origin = file.to_string();
    let embedding = Embedding::new(grid, cloth.mask.as_ref(), mesh.topology().uv(), &origin)?;
    Ok(EmbeddedMesh { mesh, embedding })
}

impl Setup {
    /// Returns the number of frames, including the start.
    pub fn frames(&self) -> usize {
        self.handles.len()
    }

    /// Returns where body `k` is at the end of a frame.
    pub(crate) fn pose(&self, k: usize, frame: usize) -> Pose {
        pose(&self.poses[k], frame)
    }

    /// Returns the control of the step that ends at `frame`, where the start is frame 0, as if nothing changed on the way
    /// ([`Script::control`](super::Script::control) knows the changes). Past the end, the handles keep their last
    /// positions.
    pub fn control<T: Float>(&self, frame: usize) -> Control<T> {
        control(&self.handles, &self.poses, &[self.wind], frame)
    }

    /// Converts a position \[m\] in the scene's axes to a handle position of a [`Control`]: in edges, z up.
    pub fn handle_at<T: Float>(&self, m: [f64; 3]) -> [T; 3] {
        self.units.position(self.up.to_z_up(m)).map(cast)
    }

    /// Converts the pose of a body in the scene's axes to one of a [`Sweep`]: in edges, z up.
    pub fn pose_of(&self, pose: &BodyPose) -> Pose {
        in_grid_units(pose, &self.units, self.up)
    }

    /// Converts the pose of a body in edges, z up, to one in the scene's axes: the inverse of [`Setup::pose_of`].
    pub fn body_pose(&self, pose: &Pose) -> BodyPose {
        in_metres(pose, &self.units, self.up)
    }

    /// Converts a velocity [m/s] in the scene's axes to the wind of a [`Control`]: in edges per frame, z up.
    pub fn wind_of<T: Float>(&self, m_s: [f64; 3]) -> [T; 3] {
        self.units.velocity(self.up.to_z_up(m_s)).map(cast)
    }

    /// Converts an acceleration [m/s^2] in the scene's axes to gravity of a [`Cloth`] or an external
    /// acceleration of a [`Control`]: in edges per frame squared, z up.
    pub fn acceleration_of<T: Float>(&self, m_s2: [f64; 3]) -> [T; 3] {
        self.units.acceleration(self.up.to_z_up(m_s2)).map(cast)
    }

    /// Converts positions \[edges\], z up, shape [3, H, W], to vertices \[m\] in the scene's axes, shape
    /// `[H W]`. Panics if there are not as many as one cloth has.
    pub fn vertices_m<T: Float>(&self, x: &[T]) -> Vec<[f64; 3]> {
        each_point(self.model.grid, x, |p| self.up.from_z_up(self.units.position_m(p)))
    }

    /// Returns the view in which vertices are in metres along the scene's axes, at the end of the frame.
    pub fn vertex_view(&self) -> VertexView {
        view_m(&self.units, self.up)
    }

    /// Converts velocities [edges / frame], z up, shape [3, H, W], to velocities [m/s] in the scene's axes,
    /// shape `[H W]`. Panics if there are not as many as one cloth has.
    pub fn velocities_m_s<T: Float>(&self, v: &[T]) -> Vec<[f64; 3]> {
        each_point(self.model.grid, v, |p| self.up.from_z_up(self.units.velocity_m_s(p)))
    }

    /// Converts the positions \[m\] and velocities [m/s] of the particles of `grid`, in particle order and
    /// the scene's axes, to a state of this setup's own grid, on which they are resampled: what
    /// [`Setup::vertices_m`] and [`Setup::velocities_m_s`] gave for another grid continues on this one.
    ///
    /// Fails if the grid is too small or too large ([`Grid::new`]), or if there is not one finite position and
    /// velocity for each of its particles.
    pub fn state_of(
        &self,
        grid: Grid,
        positions_m: &[[f64; 3]],
        velocities_m_s: &[[f64; 3]],
    ) -> Result<State<f64>> {
        let grid = Grid::new(grid.h, grid.w, "state")?;
        let checked = |name: &str, points: &[[f64; 3]]| {
            if points.len() != grid.particles() {
                let expected = format!("{} for a grid of {grid}", grid.particles());
                return Err(Error::invalid("state", name, expected, points.len()));
            }
            if let Some(p) = points.iter().position(|point| point.iter().any(|c| !c.is_finite())) {
                let field = format!("{name} of particle {p}");
                return Err(Error::invalid("state", field, "finite numbers", format!("{:?}", points[p])));
            }
            Ok(Sheet { grid, points: points.to_vec() })
        };
        let own = self.model.grid;
        let positions = checked("positions", positions_m)?.regrid(own);
        let velocities = checked("velocities", velocities_m_s)?.regrid_velocities(own);
        let convert = |sheet: Sheet, convert: &dyn Fn([f64; 3]) -> [f64; 3]| {
            field(&sheet.points.into_iter().map(|p| convert(self.up.to_z_up(p))).collect::<Vec<_>>())
        };
        Ok(State {
            x: convert(positions, &|p| self.units.position(p)),
            v: convert(velocities, &|v| self.units.velocity(v)),
        })
    }

    /// Returns the mesh of the cloth, as files hold it: the one that it carries along, or else that of its particles.
    pub fn topology(&self) -> Topology {
        match &self.embedding {
            Some(embedded) => embedded.mesh.topology().clone(),
            None => self.particle_topology(),
        }
    }

    /// Returns the mesh of the particles, whatever mesh the cloth carries along.
    pub fn particle_topology(&self) -> Topology {
        Topology::of_cloth(self.model.grid, self.model.cloths[0].mask.as_ref())
    }

    /// Returns a trajectory that holds the start and has capacity for all frames. Fails if there is not
    /// enough memory.
    pub fn trajectory(&self) -> Result<Trajectory> {
        let trajectory = Trajectory::new(self.model.grid, 1.0 / self.units.frame_time_s);
        let mut trajectory = trajectory.with_mask(self.model.cloths[0].mask.clone());
        trajectory.reserve(self.frames())?;
        self.push(&mut trajectory, &self.start.cast());
        Ok(trajectory)
    }

    /// Appends the state at the end of a frame to a trajectory. Panics if the state is not that of one cloth,
    /// or if the trajectory has another number of particles.
    pub fn push(&self, trajectory: &mut Trajectory, state: &State<f32>) {
        let [positions, velocities] = self.particles(state);
        trajectory.push(&positions, &velocities);
    }

    /// Returns positions \[m\] and velocities [m/s] of a state in the scene's axes, [V, 3] each, of the vertices of
    /// [`Setup::topology`]. Panics if the state is not that of one cloth.
    pub fn points(&self, state: &State<f32>) -> [Vec<[f32; 3]>; 2] {
        let particles = self.particles(state);
        match &self.embedding {
            Some(embedded) => particles.map(|points| embedded.embedding.positions(&points)),
            None => particles,
        }
    }

    /// Returns the same of the particles, shape [H W, 3], whatever mesh the cloth carries along: those that the cloth doesn't
    /// have lie where the nearest one does. Panics if the state is not that of one cloth.
    pub fn particles(&self, state: &State<f32>) -> [Vec<[f32; 3]>; 2] {
        let mask = self.model.cloths[0].mask.as_ref();
        let single = |points: Vec<[f64; 3]>| -> Vec<[f32; 3]> {
            let points: Vec<_> = points.into_iter().map(|p| p.map(|c| c as f32)).collect();
            match mask {
                None => points,
                Some(mask) => (0..points.len()).map(|p| points[mask.nearest(p)]).collect(),
            }
        };
        [single(self.vertices_m(&state.x)), single(self.velocities_m_s(&state.v))]
    }

    /// Combines several setups into one batch. Fails if there are none, if something changes on the way in one
    /// ([`Scripts`](super::Scripts) know of that), or if their grids or frame times differ.
    pub fn batch(setups: &[Setup]) -> Result<Batch> {
        for (k, setup) in setups.iter().enumerate() {
            if let Some(change) = setup.changes.first() {
                let expected = "no events, which Scripts and Simulator::play bring about";
                let found = format!("one in frame {}", change.frame);
                return Err(Error::invalid("batch", format!("cloth {k}"), expected, found));
            }
        }
        Self::together(setups)
    }

    /// Combines several setups as they are at the start.
    pub(super) fn together(setups: &[Setup]) -> Result<Batch> {
        let Some(first) = setups.first() else {
            return Err(Error::invalid("batch", "cloths", "at least one", 0));
        };
        let (grid, frame_time) = (first.model.grid, first.units.frame_time_s);
        for (k, setup) in setups.iter().enumerate() {
            let name = format!("cloth {k}");
            if setup.model.grid != grid {
                return Err(Error::invalid("batch", name, format!("a {grid} grid"), setup.model.grid));
            }
            if setup.units.frame_time_s != frame_time {
                let expected = format!("a frame time of {frame_time} s");
                return Err(Error::invalid("batch", name, expected, setup.units.frame_time_s));
            }
        }
        let frames = setups.iter().map(Setup::frames).max().unwrap_or(0);
        let row = |f: usize| setups.iter().flat_map(|s| s.handles[f.min(s.frames() - 1)].clone()).collect();
        Ok(Batch {
            model: Model { grid, cloths: setups.iter().flat_map(|s| s.model.cloths.clone()).collect() },
            start: State {
                x: setups.iter().flat_map(|s| s.start.x.iter().copied()).collect(),
                v: setups.iter().flat_map(|s| s.start.v.iter().copied()).collect(),
            },
            handles: (0..frames).map(row).collect(),
            poses: setups.iter().flat_map(|s| s.poses.clone()).collect(),
            wind: setups.iter().map(|s| s.wind).collect(),
            units: setups.iter().map(|s| s.units).collect(),
            up: setups.iter().map(|s| s.up).collect(),
        })
    }
}

impl Batch {
    /// Returns the number of frames, including the start.
    pub fn frames(&self) -> usize {
        self.handles.len()
    }

    /// Returns the control of the step that ends at `frame`, where the start is frame 0. Past the end, the
    /// handles keep their last positions.
    pub fn control<T: Float>(&self, frame: usize) -> Control<T> {
        control(&self.handles, &self.poses, &self.wind, frame)
    }

    /// As [`Setup::handle_at`], for cloth `b`. Panics if there is no such cloth, as the functions below do.
    pub fn handle_at<T: Float>(&self, b: usize, m: [f64; 3]) -> [T; 3] {
        self.units[b].position(self.up[b].to_z_up(m)).map(cast)
    }

    /// As [`Setup::wind_of`], for cloth `b`.
    pub fn wind_of<T: Float>(&self, b: usize, m_s: [f64; 3]) -> [T; 3] {
        self.units[b].velocity(self.up[b].to_z_up(m_s)).map(cast)
    }

    /// As [`Setup::acceleration_of`], for cloth `b`.
    pub fn acceleration_of<T: Float>(&self, b: usize, m_s2: [f64; 3]) -> [T; 3] {
        self.units[b].acceleration(self.up[b].to_z_up(m_s2)).map(cast)
    }

    /// As [`Setup::vertices_m`], for cloth `b` of positions `x` of shape [B, 3, H, W].
    pub fn vertices_m<T: Float>(&self, b: usize, x: &[T]) -> Vec<[f64; 3]> {
        each_point(self.model.grid, self.of_cloth(b, x), |p| {
            self.up[b].from_z_up(self.units[b].position_m(p))
        })
    }

    /// As [`Setup::velocities_m_s`], for cloth `b` of velocities `v` of shape [B, 3, H, W].
    pub fn velocities_m_s<T: Float>(&self, b: usize, v: &[T]) -> Vec<[f64; 3]> {
        each_point(self.model.grid, self.of_cloth(b, v), |p| {
            self.up[b].from_z_up(self.units[b].velocity_m_s(p))
        })
    }

    /// As [`Setup::vertex_view`], for cloth `b`.
    pub fn vertex_view(&self, b: usize) -> VertexView {
        view_m(&self.units[b], self.up[b])
    }

    fn of_cloth<'a, T>(&self, b: usize, field: &'a [T]) -> &'a [T] {
        let len = 3 * self.model.grid.particles();
        assert_eq!(field.len(), len * self.units.len(), "[B, 3, H, W]");
        &field[b * len..][..len]
    }
}

impl Scene {
    /// Checks the scene, reads its files and converts it to grid units, z up. Whatever is suspicious but
    /// allowed goes to `tracing`, once in the process: a scene may be set up for each of many simulations.
    pub fn setup(&self) -> Result<Setup> {
        let units = self.check()?;
        let grid = self.grid;
        memory::check(grid.particles().saturating_mul(BYTES_PER_PARTICLE), &format!("a scene of {grid}"))?;
        let map = |field: &str, of: &Option<MapFile>| of.as_ref().map(|map| map.on(grid, field)).transpose();
        let mut cloth = Cloth {
            material: self.stiffness.in_grid_units(&units, grid),
            gravity: units.acceleration(self.up.to_z_up(self.gravity)),
            air: units.air(self.wind.density, self.wind.drag),
            repulsion: self.repulsion.map(|settings| units.repulsion(settings)),
            self_contact: self.self_contact.map(|settings| self.of_layers(&units, settings)),
            damping: self.damping_s / self.frame_time_s,
            density: map("maps.density", &self.maps.density)?,
            stiffness: map("maps.stiffness", &self.maps.stiffness)?,
            rest_angles: self.rest_shape.on(grid, units.length_m, &self.origin)?,
            handles: self.handles.on(grid, &self.origin)?,
            bodies: Vec::new(),
            mask: match &self.mask {
                Some(settings) => Some(settings.on(grid, &units, &self.origin)?),
                None => None,
            },
        };
        self.check_handles(&cloth, "handles")?;
        let uneven = [
            ("a mask", cloth.mask.is_some()),
            ("maps", !self.maps.is_empty()),
            ("a rest shape", cloth.rest_angles.is_some()),
        ];
        if let Some((what, _)) = uneven.iter().find(|(_, is)| *is && self.start == Start::Settled) {
            let expected = format!("flat, hanging or a file, since a cloth with {what} has no settled drape");
            return Err(Error::invalid(&self.origin, "start", expected, "settled"));
        }
        let embedding = match &self.mesh {
            Some(file) => Some(Arc::new(embed(file, grid, &cloth)?)),
            None => None,
        };
        let wind = Airflow::new(&self.wind, &units, self.up);
        self.check_units(&units, &cloth, wind)?;
        for doubt in doubts(grid, &cloth, &units) {
            warn_once(format!("{}: material: {doubt}", self.origin));
        }
        let [mut points, velocities] = self.start.on(&cloth, &units, (grid, self.up), &self.origin)?;
        let particles = cloth.handles.clone();
        let at_start: Vec<[f64; 3]> = particles.iter().map(|&p| points[p]).collect();
        let attached = self.attached_bodies(particles.len())?;
        let mut handles = self.trajectory(&units, &at_start)?;
        self.warn_if_size_differs(&points);
        // The first row of a recording places the handles at the start; for a built-in motion this changes
        // nothing.
        let gaps =
            particles.iter().zip(&handles[0]).map(|(&p, &at)| (norm(zip(points[p], at, |p, at| p - at)), p));
        let far: Vec<(f64, usize)> = gaps
            .zip(&attached)
            .filter(|((gap, _), of)| *gap > 1.0 && of.is_none())
            .map(|(far, _)| far)
            .collect();
        if let Some(&(gap, p)) = far.iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
            warn_once(format!(
                "{}: motion: {} of {} handles do not begin where the start state has them; handle {p} is off by {gap:.1} edges",
                self.origin,
                far.len(),
                particles.len()
            ));
        }
        particles.iter().zip(&handles[0]).for_each(|(&p, &at)| points[p] = at);
        let mut poses: Vec<Vec<Pose>> = Vec::new();
        for (k, settings) in self.bodies.iter().enumerate() {
            let field = format!("bodies[{k}]");
            let of_scene = (&units, self.up, handles.len());
            let of_cloth = (self.thickness_m, self.friction);
            let (body, path) = settings.setup(of_scene, of_cloth, (&self.origin, &field))?;
            if body.thickness > 0.5 {
                warn_once(format!(
                    "{}: {field}: the cloth stays {:.2} edges away, more than half an edge: is thickness_m in metres?",
                    self.origin, body.thickness
                ));
            }
            cloth.bodies.push(body);
            poses.push(path);
        }
        // Those that follow a body, from where the start has them.
        for (handle, body) in attached.iter().enumerate() {
            let Some(poses) = body.map(|body| &poses[body]) else { continue };
            let own = poses[0].inward(at_start[handle].into());
            for (frame, row) in handles.iter_mut().enumerate() {
                row[handle] = pose(poses, frame).outward(own).to_array();
            }
            points[particles[handle]] = at_start[handle];
        }
        let changes = self.changes(&units, handles.len(), (&cloth, wind))?;
        changes.iter().try_for_each(|change| {
            self.check_handles(&change.cloth, &format!("handles from frame {} on", change.frame))
        })?;
        self.move_out_of_bodies(&cloth, &attached, &mut points);
        self.untangle(&cloth, &mut points);
        self.warn_of_jumps(&cloth, &poses);
        let setup = Setup {
            start: State { x: field(&points), v: field(&velocities) },
            model: Model { grid, cloths: vec![cloth] },
            handles,
            attached,
            poses,
            changes,
            wind,
            units,
            up: self.up,
            embedding,
        };
        self.check_places(&setup)?;
        let farthest = setup.start.x.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        if farthest * f64::from(f32::EPSILON) > COARSEST {
            let away = farthest * units.length_m;
            warn_once(format!(
                "{}: the cloth lies {away:.0} m from the origin, where single precision resolves only {:.3} edges",
                self.origin,
                farthest * f64::from(f32::EPSILON)
            ));
        }
        Ok(setup)
    }

    /// Fails if the cloth doesn't have one of its handles.
    fn check_handles(&self, cloth: &Cloth, field: &str) -> Result<()> {
        let Some(mask) = &cloth.mask else { return Ok(()) };
        let w = self.grid.w;
        let shown = |p: usize| format!("[{}, {}]", p / w, p % w);
        match cloth.handles.iter().find(|&&p| !mask.contains(p)) {
            None => Ok(()),
            Some(&p) => {
                let expected = format!("particles that the mask leaves, such as {}", shown(mask.nearest(p)));
                Err(Error::invalid(&self.origin, field, expected, shown(p)))
            }
        }
    }

    /// Moves free particles that are inside a body, or nearer than its thickness, out of it, and warns if any were inside.
    fn move_out_of_bodies(&self, cloth: &Cloth, attached: &[Option<usize>], points: &mut [[f64; 3]]) {
        let handles: BTreeMap<usize, Option<usize>> =
            cloth.handles.iter().copied().zip(attached.iter().copied()).collect();
        for (k, body) in cloth.bodies.iter().enumerate().filter(|(_, body)| body.present) {
            let (mut inside, mut held) = (0, 0);
            for (p, point) in points.iter_mut().enumerate().filter(|(p, _)| cloth.contains(*p)) {
                let own = body.pose.inward((*point).into());
                let surface = body.shape.distance(own);
                let is_inside = surface.distance < 0.0;
                if let Some(attached) = handles.get(&p) {
                    held += usize::from(is_inside && *attached != Some(k));
                } else if surface.distance < body.thickness {
                    inside += usize::from(is_inside);
                    let out = body.pose.turned(surface.normal) * (body.thickness - surface.distance);
                    *point = (DVec3::from(*point) + out).to_array();
                }
            }
            let (origin, shape) = (&self.origin, body.shape.name());
            if inside > 0 {
                warn_once(format!(
                    "{origin}: bodies[{k}]: {inside} particles of the start were inside the {shape}; they were moved out"
                ));
            }
            if held > 0 {
                warn_once(format!(
                    "{origin}: bodies[{k}]: {held} handles begin inside the {shape}; handles go where they are told"
                ));
            }
        }
    }

    /// Moves layers of a cloth that touches itself out of each other where they have passed through each other, if short moves do
    /// that ([`untangle`]). Warns if they have; also of a cloth whose layers repel each other, which stays as it is.
    fn untangle(&self, cloth: &Cloth, points: &mut [[f64; 3]]) {
        if self.repulsion.is_none() && self.self_contact.is_none() {
            return;
        }
        let mut x = field(points);
        let found = intersections(&cloth.faces(self.grid), &x);
        let Some(Intersection { edge: [p, q], .. }) = found.first() else { return };
        let what = format!(
            "{}: start: the cloth passes through itself: {} of its edges meet a triangle of it, first that between particles \
             {p} and {q}",
            self.origin,
            found.iter().map(|one| one.edge).collect::<BTreeSet<_>>().len()
        );
        if self.self_contact.is_some() && untangle(self.grid, cloth, &mut x) {
            let n = points.len();
            let mut farthest = 0.0_f64;
            for (p, point) in points.iter_mut().enumerate() {
                let to = [0, 1, 2].map(|c| x[c * n + p]);
                farthest = farthest.max(norm(zip(to, *point, |to, from| to - from)));
                *point = to;
            }
            warn_once(format!(
                "{what}; its layers were moved out of each other, by {farthest:.1} edges at most"
            ));
        } else {
            warn_once(format!("{what}; repulsion and self-contact keep layers on the sides where they are"));
        }
    }

    /// Warns of bodies that jump by more than their size from one frame to the next.
    fn warn_of_jumps(&self, cloth: &Cloth, poses: &[Vec<Pose>]) {
        for (k, (body, poses)) in cloth.bodies.iter().zip(poses).enumerate() {
            let far = |pair: &[Pose]| {
                (DVec3::from(pair[1].position) - DVec3::from(pair[0].position)).length()
                    > 2.0 * body.shape.reach()
            };
            if let Some(frame) = poses.windows(2).position(far) {
                warn_once(format!(
                    "{}: bodies[{k}]: it moves by more than its size in frame {}; what it passes is still met",
                    self.origin,
                    frame + 1
                ));
            }
        }
    }

    /// Warns if the start's edges are not about as long as the sheet's. The usual mistake is a wrong unit or
    /// side.
    fn warn_if_size_differs(&self, points: &[[f64; 3]]) {
        let Grid { h, w } = self.grid;
        let mean = |edges: &mut dyn Iterator<Item = (usize, usize)>| {
            let lengths: Vec<f64> =
                edges.map(|(p, q)| norm(zip(points[p], points[q], |p, q| q - p))).collect();
            lengths.iter().sum::<f64>() / lengths.len() as f64
        };
        let along_height = mean(&mut (0..(h - 1) * w).map(|p| (p, p + w)));
        let along_width = mean(&mut (0..h * w).filter(|p| p % w > 0).map(|p| (p - 1, p)));
        for (field, length) in [("height", along_height), ("width", along_width)] {
            if !USUAL.contains(&length) {
                warn_once(format!(
                    "{}: start: edges along the {field} are {length:.3} times as long as at rest: is side_m, the {field}, that of \
                     the sheet in the start?",
                    self.origin
                ));
            }
        }
    }

    /// Returns the handle positions \[edges\], z up, of each frame, given those at the start.
    fn trajectory(&self, units: &Units, at_start: &[[f64; 3]]) -> Result<Vec<Vec<[f64; 3]>>> {
        let many = at_start.len();
        if many == 0 && self.motion != Motion::Still {
            let expected = format!("a handle for the motion '{}' (or the motion 'none')", self.motion);
            return Err(Error::invalid(&self.origin, "handles", expected, "none"));
        }
        match &self.motion {
            Motion::Still => {
                let frames = self.frame_count(STILL_FRAMES as f64 - 1.0, many)?;
                Ok(vec![at_start.to_vec(); frames])
            }
            Motion::BuiltIn(motion) => {
                let step = units.frame_time_s * self.speed;
                let frames = self.frame_count(super::BuiltIn::DURATION_S / step, many)?;
                let axes = UpAxis::Y;
                let start: Vec<_> = at_start.iter().map(|&p| axes.from_z_up(units.position_m(p))).collect();
                let inside = |p| units.position(axes.to_z_up(p));
                let row = |f: usize| motion.at(f as f64 * step, &start).into_iter().map(inside).collect();
                Ok((0..frames).map(row).collect())
            }
            Motion::File(path) => self.play(&Recording::read(path, many)?, units, many),
            Motion::Rows(rows) => self.play(&Recording::from_rows(rows, many, &self.origin)?, units, many),
        }
    }

    /// Implements [`Scene::trajectory`] for a recording of `many` handles.
    fn play(&self, recording: &Recording, units: &Units, many: usize) -> Result<Vec<Vec<[f64; 3]>>> {
        let frames = self.frame_count((recording.frames() - 1) as f64 / self.speed, many)?;
        let inside = |p| units.position(self.up.to_z_up(p));
        let row = |f: usize| recording.at(f as f64 * self.speed).into_iter().map(inside).collect();
        Ok((0..frames).map(row).collect())
    }

    /// Returns the number of frames that the scene specifies, or the number that reaches the end of its
    /// motion, `steps` after the start.
    fn frame_count(&self, steps: f64, handles: usize) -> Result<usize> {
        let (field, frames) = match self.frames {
            Some(frames) => ("frames", frames),
            // Slightly less, so that 390.00000000000006 steps do not become 391.
            None => ("frame_time_s, speed", ((steps - 1e-6).ceil().max(0.0) as usize).saturating_add(1)),
        };
        let most = MAX_FRAMES.min(MAX_HANDLE_POSITIONS / handles.max(1));
        if (1..=most).contains(&frames) {
            Ok(frames)
        } else {
            let expected = format!("1 to {most} frames with {handles} handles");
            Err(Error::invalid(&self.origin, field, expected, frames))
        }
    }

    /// Fails if a constant of the cloth overflows in grid units, or in single precision, in which frames are computed
    /// and written, though it is finite in SI units.
    pub(super) fn check_units(&self, units: &Units, cloth: &Cloth, wind: Airflow) -> Result<()> {
        let material = cloth.material;
        let air = [cloth.air.density, cloth.air.drag];
        self.check_single("side_m, frame_time_s", [units.length_m, units.length_m / units.frame_time_s])?;
        let coefficients = [[material.stretch, material.shear], material.stretches(), material.bends()];
        self.check_single("material", coefficients.as_flattened().iter().copied())?;
        self.check_single("damping_s", [cloth.damping])?;
        self.check_single("gravity", cloth.gravity)?;
        self.check_single("wind", air.into_iter().chain(wind.velocity).chain([wind.gusts]))
    }

    /// Fails likewise if a position or a velocity overflows.
    fn check_places(&self, setup: &Setup) -> Result<()> {
        // Before the start, in which the handles are already where the motion begins.
        self.check_single("motion", setup.handles.iter().flatten().flatten().copied())?;
        let metres = setup.vertices_m(&setup.start.x);
        let State { x, v } = &setup.start;
        self.check_single("start", x.iter().chain(v).chain(metres.as_flattened()).copied())
    }

    fn check_single(&self, field: &str, values: impl IntoIterator<Item = f64>) -> Result<()> {
        if values.into_iter().all(|v| (v as f32).is_finite()) {
            return Ok(());
        }
        let expected = "values that stay finite in grid units and in single precision";
        Err(Error::invalid(&self.origin, field, expected, "an overflow"))
    }

    /// Moves the scene to another grid. The side along the height is kept and cells are square, so the width
    /// follows, and the total mass with it. Grid coefficients and moduli keep their values. Listed handles
    /// move to the nearest particle; those that meet on one are merged unless the motion is recorded. Recorded
    /// start states are resampled.
    ///
    /// Fails, and changes nothing, if a grid is not valid ([`Grid::new`]), or if two handles of a recorded
    /// motion meet.
    pub fn regrid(&mut self, grid: Grid) -> Result<()> {
        let old = Grid::new(self.grid.h, self.grid.w, &self.origin)?;
        let grid = Grid::new(grid.h, grid.w, &self.origin)?;
        // A recording has a row for each handle.
        let recorded = matches!(self.motion, Motion::File(_) | Motion::Rows(_));
        let (handles, numbers) = Handles::regrid(&self.handles, old, grid, !recorded);
        if recorded && self.handles.on(old, &self.origin).is_ok() && handles.on(grid, &self.origin).is_err() {
            let expected = "a grid on which each handle of the recorded motion has a particle of its own";
            return Err(Error::invalid(&self.origin, "grid", expected, grid));
        }
        self.events.iter_mut().for_each(|event| event.regrid(old, grid));
        let mut seen = HashMap::new();
        self.attached.iter_mut().for_each(|attachment| attachment.renumber(&numbers, &mut seen));
        self.mass.scale_area(grid.aspect() / old.aspect());
        if let super::Side::Both([height, width]) = self.side_m {
            let now = height * grid.aspect();
            if (now - width).abs() > 0.1 * width {
                let origin = &self.origin;
                warn_once(format!(
                    "{origin}: side_m: on {grid} particles the sheet is {now:.3} m wide, not {width} m"
                ));
            }
        }
        self.side_m = super::Side::Height(self.side_m.height());
        self.handles = handles;
        if let Start::File(file) = &mut self.start {
            file.grid.get_or_insert(old);
        }
        self.grid = grid;
        Ok(())
    }
}
