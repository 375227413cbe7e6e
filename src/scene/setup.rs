//! What a simulation needs of a scene: everything in grid units, z up.

use super::motion::Recording;
use super::points::{norm, zip};
use super::{Handles, Motion, Scene, Units, UpAxis};
use crate::io::Trajectory;
use crate::sim::{Cloth, Control, Grid, Model, State, cast};
use crate::{Error, Result};
use num_traits::Float;
use std::ops::RangeInclusive;

/// The longest run, and the most handle positions, that a scene may ask for: far above any use, well inside memory.
const MAX_FRAMES: usize = 1_000_000;
const MAX_HANDLE_POSITIONS: usize = 50_000_000;
/// Spacing of the numbers in single precision \[edges\] beyond which frames suffer from where the cloth is.
const COARSEST: f64 = 1e-3;
/// Mean lengths of a start's edges \[edges\] that need no word: folds and wrinkles leave edges as they are.
const USUAL: RangeInclusive<f64> = 0.9..=1.1;
/// Frames of a scene whose handles stay, where it does not say how many: as many as the built-in motions have.
const STILL_FRAMES: usize = 391;

/// A scene made ready: one cloth in grid units, z up, and the way back to SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// What stays fixed; one cloth.
    pub model: Model,
    /// The start state, frame 0.
    pub start: State<f64>,
    /// Handle positions \[edges\] for each frame, the start included, shape `[frames][handles]`.
    pub handles: Vec<Vec<[f64; 3]>>,
    /// Wind velocity [edges / frame].
    pub wind: [f64; 3],
    /// What an edge, a frame and a cell weigh in SI units.
    pub units: Units,
    /// The axis that points up at the surface.
    pub up: UpAxis,
}

/// Several cloths on one grid, ready to advance together.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// What stays fixed; B cloths.
    pub model: Model,
    /// The start states, frame 0.
    pub start: State<f64>,
    /// Handle positions \[edges\] for each frame, all handles of cloth 0, then of cloth 1, and so on. As many frames as
    /// the longest cloth has; the handles of the others stay at their last positions.
    pub handles: Vec<Vec<[f64; 3]>>,
    /// Wind velocity of each cloth [edges / frame], shape `[B]`.
    pub wind: Vec<[f64; 3]>,
    /// Units of each cloth, shape `[B]`.
    pub units: Vec<Units>,
    /// The axis that points up at the surface of each cloth, shape `[B]`.
    pub up: Vec<UpAxis>,
}

/// Positions, velocities or the like, shape [3, H, W], point by point through `f`.
fn each_point<T: Float>(field: &[T], f: impl Fn([f64; 3]) -> [f64; 3]) -> Vec<[f64; 3]> {
    let n = field.len() / 3;
    (0..n).map(|p| f([p, n + p, 2 * n + p].map(|k| cast(field[k])))).collect()
}

/// Points in the order of their numbers as a field of shape [3, H, W].
fn field(points: &[[f64; 3]]) -> Vec<f64> {
    (0..3).flat_map(|c| points.iter().map(move |p| p[c])).collect()
}

/// The control of a frame; the handles of a frame past the end stay at their last positions.
fn control<T: Float>(handles: &[Vec<[f64; 3]>], wind: &[[f64; 3]], frame: usize) -> Control<T> {
    let row = handles.get(frame).or(handles.last()).map_or(&[][..], Vec::as_slice);
    Control {
        handles: row.iter().map(|p| p.map(cast)).collect(),
        wind: wind.iter().map(|w| w.map(cast)).collect(),
        external: Vec::new(),
    }
}

impl Setup {
    /// Number of frames, the start included.
    pub fn frames(&self) -> usize {
        self.handles.len()
    }

    /// What drives the step that ends at `frame`, counted from the start as 0; past the end the handles stay.
    pub fn control<T: Float>(&self, frame: usize) -> Control<T> {
        control(&self.handles, &[self.wind], frame)
    }

    /// A place \[m\] in the scene's axes as a [`Control`] has a handle there: in edges, z up.
    pub fn handle_at<T: Float>(&self, m: [f64; 3]) -> [T; 3] {
        self.units.position(self.up.to_z_up(m)).map(cast)
    }

    /// A velocity [m/s] in the scene's axes as a [`Control`] has wind: in edges a frame, z up.
    pub fn wind_of<T: Float>(&self, m_s: [f64; 3]) -> [T; 3] {
        self.units.velocity(self.up.to_z_up(m_s)).map(cast)
    }

    /// Positions \[edges\], z up, shape [3, H, W], as vertices \[m\] in the scene's axes, shape `[H W]`.
    pub fn vertices_m<T: Float>(&self, x: &[T]) -> Vec<[f64; 3]> {
        each_point(x, |p| self.up.from_z_up(self.units.position_m(p)))
    }

    /// Velocities [edges / frame], z up, shape [3, H, W], as velocities [m/s] in the scene's axes, shape `[H W]`.
    pub fn velocities_m_s<T: Float>(&self, v: &[T]) -> Vec<[f64; 3]> {
        each_point(v, |p| self.up.from_z_up(self.units.velocity_m_s(p)))
    }

    /// A trajectory that holds the start and has room for all frames; an error when memory does not suffice.
    pub fn trajectory(&self) -> Result<Trajectory> {
        let mut trajectory = Trajectory::new(self.model.grid, 1.0 / self.units.frame_time_s);
        trajectory.reserve(self.frames())?;
        self.push(&mut trajectory, &self.start.cast());
        Ok(trajectory)
    }

    /// Adds the state at the end of a frame to a trajectory.
    pub fn push(&self, trajectory: &mut Trajectory, state: &State<f32>) {
        let single =
            |points: Vec<[f64; 3]>| points.into_iter().map(|p| p.map(|c| c as f32)).collect::<Vec<_>>();
        trajectory.push(&single(self.vertices_m(&state.x)), &single(self.velocities_m_s(&state.v)));
    }

    /// Makes one batch of several scenes on one grid with one frame time.
    pub fn batch(setups: &[Setup]) -> Result<Batch> {
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
            wind: setups.iter().map(|s| s.wind).collect(),
            units: setups.iter().map(|s| s.units).collect(),
            up: setups.iter().map(|s| s.up).collect(),
        })
    }
}

impl Batch {
    /// Number of frames, the start included.
    pub fn frames(&self) -> usize {
        self.handles.len()
    }

    /// What drives the step that ends at `frame`, counted from the start as 0; past the end the handles stay.
    pub fn control<T: Float>(&self, frame: usize) -> Control<T> {
        control(&self.handles, &self.wind, frame)
    }
}

impl Scene {
    /// Checks the scene, reads its files and turns it into grid units, z up.
    pub fn setup(&self) -> Result<Setup> {
        let units = self.check()?;
        let grid = self.grid;
        let particles = self.handles.on(grid, &self.origin)?;
        let [mut points, velocities] = self.start.on(grid, &units, self.up)?;
        let at_start: Vec<[f64; 3]> = particles.iter().map(|&p| points[p]).collect();
        let handles = self.trajectory(&units, &at_start)?;
        self.tell_other_size(&points);
        // A recording's first row is where the handles are at the start; for a built-in motion this changes nothing.
        let gaps =
            particles.iter().zip(&handles[0]).map(|(&p, &at)| (norm(zip(points[p], at, |p, at| p - at)), p));
        let far: Vec<(f64, usize)> = gaps.filter(|&(gap, _)| gap > 1.0).collect();
        if let Some(&(gap, p)) = far.iter().max_by(|a, b| a.0.total_cmp(&b.0)) {
            tracing::warn!(
                "{}: motion: {} of {} handles begin elsewhere than the start state has them, handle {p} by {gap:.1} edges",
                self.origin,
                far.len(),
                particles.len()
            );
        }
        particles.iter().zip(&handles[0]).for_each(|(&p, &at)| points[p] = at);
        let cloth = Cloth {
            material: self.stiffness.in_grid_units(&units),
            gravity: units.acceleration(self.up.to_z_up(self.gravity)),
            air: units.air(self.wind.density, self.wind.drag),
            repulsion: self.repulsion.map(|separation| units.repulsion(separation)),
            handles: particles,
        };
        let setup = Setup {
            start: State { x: field(&points), v: field(&velocities) },
            model: Model { grid, cloths: vec![cloth] },
            handles,
            wind: units.velocity(self.up.to_z_up(self.wind.velocity)),
            units,
            up: self.up,
        };
        self.check_finite(&setup)?;
        let farthest = setup.start.x.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        if farthest * f64::from(f32::EPSILON) > COARSEST {
            let away = farthest * units.length_m;
            tracing::warn!(
                "{}: the cloth lies {away:.0} m from the origin, where single precision tells apart what is {:.3} edges apart",
                self.origin,
                farthest * f64::from(f32::EPSILON)
            );
        }
        Ok(setup)
    }

    /// Says so where the start's edges are not about as long as the sheet's: the usual mistake is another unit or side.
    fn tell_other_size(&self, points: &[[f64; 3]]) {
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
                tracing::warn!(
                    "{}: start: edges along the {field} are {length:.3} times as long as at rest: is side_m, the {field}, that of \
                     the sheet in the start?",
                    self.origin
                );
            }
        }
    }

    /// Handle positions \[edges\], z up, for each frame, from the handles' places at the start.
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

    /// [`Scene::trajectory`] of a recording of `many` handles.
    fn play(&self, recording: &Recording, units: &Units, many: usize) -> Result<Vec<Vec<[f64; 3]>>> {
        let frames = self.frame_count((recording.frames() - 1) as f64 / self.speed, many)?;
        let inside = |p| units.position(self.up.to_z_up(p));
        let row = |f: usize| recording.at(f as f64 * self.speed).into_iter().map(inside).collect();
        Ok((0..frames).map(row).collect())
    }

    /// The frames that the scene asks for, or those that it takes to the end of its motion, `steps` after the start.
    fn frame_count(&self, steps: f64, handles: usize) -> Result<usize> {
        let (field, frames) = match self.frames {
            Some(frames) => ("frames", frames),
            // A hair less, lest 390.00000000000006 become 391 steps.
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

    /// Numbers that are finite in SI units may not be so in grid units, nor in single precision, in which frames are computed
    /// and written.
    fn check_finite(&self, setup: &Setup) -> Result<()> {
        let single = |v: f64| (v as f32).is_finite();
        let (cloth, units) = (&setup.model.cloths[0], &setup.units);
        let material = [cloth.material.stretch, cloth.material.shear, cloth.material.bend];
        let wind = [cloth.air.density, cloth.air.drag].into_iter().chain(setup.wind);
        let start = setup.vertices_m(&setup.start.x);
        let fields: [(&str, bool); 6] = [
            (
                "side_m, frame_time_s",
                [units.length_m, units.length_m / units.frame_time_s].into_iter().all(single),
            ),
            ("material", material.into_iter().all(single)),
            ("gravity", cloth.gravity.into_iter().all(single)),
            ("wind", wind.into_iter().all(single)),
            (
                "start",
                setup.start.x.iter().chain(&setup.start.v).chain(start.as_flattened()).all(|&v| single(v)),
            ),
            ("motion", setup.handles.iter().flatten().flatten().all(|&v| single(v))),
        ];
        match fields.iter().find(|(_, finite)| !finite) {
            None => Ok(()),
            Some((name, _)) => Err(Error::invalid(
                &self.origin,
                *name,
                "values that stay finite in grid units and in single precision",
                "an overflow",
            )),
        }
    }

    /// The same scene on another grid: the side along the height stays and cells are square, so the width follows, and
    /// so does the total mass; grid coefficients stay as they are, moduli stay the sheet's; listed handles move to the
    /// nearest particle, several to one if no recording moves them, and a start state from a file is resampled.
    pub fn regrid(&mut self, grid: Grid) -> Result<()> {
        let old = Grid::new(self.grid.h, self.grid.w, &self.origin)?;
        let grid = Grid::new(grid.h, grid.w, &self.origin)?;
        self.mass.scale_area(grid.aspect() / old.aspect());
        if let super::Side::Both([height, width]) = self.side_m {
            let now = height * grid.aspect();
            if (now - width).abs() > 0.1 * width {
                let origin = &self.origin;
                tracing::warn!(
                    "{origin}: side_m: on {grid} particles the sheet is {now:.3} m wide, not {width} m"
                );
            }
        }
        self.side_m = super::Side::Height(self.side_m.height());
        // A recording has a row for each handle.
        let recorded = matches!(self.motion, Motion::File(_) | Motion::Rows(_));
        self.handles = Handles::regrid(&self.handles, old, grid, !recorded);
        if let super::Start::File(file) = &mut self.start
            && !file.is_trajectory()
        {
            file.grid.get_or_insert(old);
        }
        self.grid = grid;
        Ok(())
    }
}
