//! A scene that runs.

use super::changes::{Changes, Values};
use super::draw::{Marker, Mesh, Placed};
use super::grip::Grip;
use super::record::Recorder;
use super::solids::{Room, Solid, columns};
use crate::cloth::{Cloth, Model, State};
use crate::gpu::{Context, Readback};
use crate::network::Weights;
use crate::render::Bodies;
use crate::scene::{Script, Setup};
use crate::sim::{FrameStats, Optimizer, Solver, Vertices};
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// Frames of which the device may be ahead of the host.
const IN_FLIGHT: usize = 3;

/// Names of the solvers that run on a device.
pub const SOLVERS: [&str; 7] = ["fnopt", "spectral", "quasi-newton", "fnopt-paper", "lbfgs", "adam", "gd"];

/// A scene on a device, which the pointer and the panel may change while it runs.
pub struct Live {
    context: Context,
    setup: Setup,
    weights: Arc<Weights>,
    optimizer: Optimizer,
    iterations: usize,
    solver: Solver,
    vertices: Vertices,
    readback: Readback,
    cloth_mesh: Mesh,
    bodies: Bodies,
    /// A mesh for each body, and the patch that is drawn of a plane.
    solids: Vec<(Mesh, Option<[f32; 4]>)>,
    room: Room,
    /// The last frame that was submitted, and the last that has arrived here.
    frame: usize,
    arrived: usize,
    /// The last state and statistics that have arrived.
    state: State<f32>,
    stats: Option<FrameStats>,
    /// The last frame whose events have come, and what holds the handles since then.
    entered: usize,
    anchors: Vec<f64>,
    /// Where the handles are in the last frame that was submitted, in edges, z up.
    handles: Vec<[f32; 3]>,
    grip: Grip,
    changes: Changes,
    recorder: Option<Recorder>,
    /// The first frame that is not finite.
    broken: Option<usize>,
    /// Statistics of the frames that have arrived since they were last asked for.
    news: Vec<(usize, FrameStats)>,
}

impl Live {
    /// Sets a scene up on a device, with this optimizer and its iterations per frame. Fails as [`Solver::new`] does.
    pub fn new(context: &Context, setup: Setup, optimizer: Optimizer, iterations: usize) -> Result<Self> {
        let weights = optimizer.weights().cloned();
        let state: State<f32> = setup.start.cast();
        let [places, _] = setup.particles(&state);
        let parts = Parts::new(context, &setup, &setup.model, &optimizer, iterations)?;
        let mut bodies = Bodies::new(&setup.model.cloths[0].bodies, &setup.poses, &setup.vertex_view());
        setup.changes.iter().for_each(|change| bodies.change(change.frame, &change.cloth.bodies));
        let room = room(&places);
        let all = Bodies::new(&shown(&setup.model.cloths[0]).bodies, &setup.poses, &setup.vertex_view());
        let solids = all.there(0).map(|(_, shape, pose)| {
            let solid = Solid::new(shape, pose, room);
            (Mesh::of_body(&context.device, &solid), solid.patch)
        });
        let anchors = Script::new(&setup).anchors().to_vec();
        let handles = setup.handles[0].iter().map(|p| p.map(|c| c as f32)).collect();
        let live = Self {
            context: context.clone(),
            weights: weights.unwrap_or_else(|| Arc::new(Weights::shipped())),
            optimizer,
            iterations,
            solver: parts.solver,
            vertices: parts.vertices,
            readback: parts.readback,
            cloth_mesh: parts.mesh,
            solids: solids.collect(),
            bodies,
            room,
            frame: 0,
            arrived: 0,
            state,
            stats: None,
            entered: 0,
            anchors,
            handles,
            grip: Grip::default(),
            changes: Changes::default(),
            recorder: None,
            broken: None,
            news: Vec::new(),
            setup,
        };
        live.solver.set_state(&live.state);
        Ok(live)
    }

    /// Returns the setup of the scene.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }

    /// Returns the number of the last frame; the start is frame 0.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// Returns the first frame that is not finite, in which the simulation ends.
    pub fn broken(&self) -> Option<usize> {
        self.broken
    }

    /// Returns name and iterations of the solver.
    pub fn solver(&self) -> (&'static str, usize) {
        (self.optimizer.name(), self.iterations)
    }

    /// Returns what replaces the scene's own values.
    pub fn changes(&self) -> Changes {
        self.changes
    }

    /// Returns the values of the cloth as it is now.
    pub fn values(&self) -> Values {
        let change = self.setup.changes.iter().rfind(|change| change.frame <= self.entered);
        let wind = change.map_or(self.setup.wind, |change| change.wind).velocity;
        self.changes.values(&self.setup, self.script().cloth(), wind)
    }

    /// Returns statistics of the last frame that has arrived.
    pub fn stats(&self) -> Option<&FrameStats> {
        self.stats.as_ref()
    }

    /// Converts an energy of [`FrameStats`] to joules.
    pub fn joules(&self, energy: f64) -> f64 {
        self.changes.units(&self.setup).energy_j(energy, self.setup.model.grid.particles())
    }

    /// Takes the statistics of the frames that have arrived since the last call, with their numbers.
    pub(super) fn take_news(&mut self) -> Vec<(usize, FrameStats)> {
        std::mem::take(&mut self.news)
    }

    /// Returns the positions of the particles in the last frame that has arrived \[m\], in the scene's axes.
    pub fn positions(&self) -> Vec<[f32; 3]> {
        let [positions, _] = self.setup.particles(&self.state);
        positions
    }

    /// Returns the handles: those of the scene, and then those that the pointer holds or has pinned.
    pub fn handles(&self) -> Vec<usize> {
        let own = &self.script().cloth().handles;
        own.iter().copied().chain(self.grip.extra(own)).collect()
    }

    /// Returns where the scene leads its handles, and the bodies that are not planes, in the first frame \[m\].
    pub(super) fn reach(&self) -> Vec<Vec3> {
        let (units, up) = (&self.setup.units, self.setup.up);
        let metres = |at: &[f64; 3]| Vec3::from(up.from_z_up(units.position_m(*at)).map(|c| c as f32));
        let mut points: Vec<Vec3> = self.setup.handles.iter().flatten().map(metres).collect();
        for (_, shape, pose) in self.bodies.there(0) {
            let (at, reach) = (DVec3::from(pose.position).as_vec3(), shape.reach() as f32);
            if reach < 2.0 * self.room.size {
                points.extend(
                    [Vec3::X, Vec3::Y, Vec3::Z]
                        .into_iter()
                        .flat_map(|axis| [at - reach * axis, at + reach * axis]),
                );
            }
        }
        points
    }

    /// Returns the upward direction of the scene's axes.
    pub(super) fn up(&self) -> Vec3 {
        Vec3::from(self.setup.up.down(-1.0).map(|c| c as f32))
    }

    fn script(&self) -> Script<'_> {
        let anchors = Script::resume(&self.setup, self.entered, &self.anchors);
        anchors.expect("the anchors are those of the script")
    }

    /// Submits the next frame. Does nothing once a frame was not finite. Fails if the device is lost.
    pub fn step(&mut self) -> Result<()> {
        if self.readback.is_full() {
            let arrived = self.readback.next(|bytes| self.solver.frame(bytes))?;
            self.arrive(arrived)?;
        }
        let next = self.frame + 1;
        if self.script().next_change().is_some_and(|change| change <= next) {
            self.settle()?;
            if self.broken.is_none() {
                self.enter(next)?;
            }
        }
        if self.broken.is_some() {
            return Ok(());
        }
        let mut control = self.script().control::<f32>(next);
        let handles = &self.script().cloth().handles.clone();
        let units = (self.setup.units.length_m, self.setup.units.frame_time_s);
        control.handles = self.grip.place(handles, &control.handles, units);
        if let Some(wind) = self.changes.wind {
            control.wind = vec![self.setup.wind_of(wind)];
        }
        self.solver.set_control(&control);
        self.handles = control.handles;
        let submission = self.context.submit(|encoder| {
            self.solver.record(encoder);
            self.readback.record(encoder);
        });
        self.readback.submitted(&submission);
        self.frame = next;
        Ok(())
    }

    fn enter(&mut self, frame: usize) -> Result<()> {
        let mut script = self.script();
        script.enter(frame, &self.state);
        let (anchors, handles) = (script.anchors().to_vec(), script.cloth().handles.clone());
        (self.entered, self.anchors) = (frame, anchors);
        self.grip.tidy(&handles);
        self.replace_cloth()
    }

    /// Takes the frames that have arrived. Fails if the device is lost, or if a recording cannot be kept.
    pub fn poll(&mut self) -> Result<()> {
        while let Some(frame) = self.readback.try_next(|bytes| self.solver.frame(bytes))? {
            self.arrive(Some(frame))?;
        }
        Ok(())
    }

    /// Waits for all frames that were submitted. Fails as [`Live::poll`] does.
    pub fn settle(&mut self) -> Result<()> {
        while let Some(frame) = self.readback.next(|bytes| self.solver.frame(bytes))? {
            self.arrive(Some(frame))?;
        }
        Ok(())
    }

    fn arrive(&mut self, frame: Option<(State<f32>, Vec<FrameStats>)>) -> Result<()> {
        let Some((state, mut stats)) = frame else { return Ok(()) };
        self.arrived += 1;
        if self.broken.is_some() {
            return Ok(());
        }
        let stats = stats.swap_remove(0);
        let overflows = stats.layers.is_some_and(|layers| layers.overflow.is_some());
        let finite = state.x.iter().chain(&state.v).all(|c| c.is_finite());
        if !finite || !stats.is_finite() || overflows {
            self.broken = Some(self.arrived);
            return Ok(());
        }
        (self.state, self.stats) = (state, Some(stats.clone()));
        self.news.push((self.arrived, stats));
        if let Some(recorder) = &mut self.recorder {
            let [positions, velocities] = self.setup.particles(&self.state);
            recorder.push(&positions, &velocities)?;
        }
        Ok(())
    }

    /// Returns the cloth that the solver is to have now.
    fn cloth(&self) -> Cloth {
        let script = self.script();
        let mut cloth = self.changes.apply(&self.setup, script.cloth());
        let extra = self.grip.extra(&cloth.handles);
        cloth.handles.extend(extra);
        cloth
    }

    fn replace_cloth(&mut self) -> Result<()> {
        let cloth = self.cloth();
        self.solver.set_cloths(&[cloth])
    }

    /// Replaces the scene's own values from the next frame on. Fails, and changes nothing, if one is not valid.
    pub fn change(&mut self, changes: Changes) -> Result<()> {
        let before = std::mem::replace(&mut self.changes, changes);
        let replaced = self.replace_cloth();
        if replaced.is_err() {
            self.changes = before;
        }
        replaced
    }

    /// Builds another solver, which goes on from the current state. Fails, and changes nothing, if the name is not one of
    /// [`SOLVERS`], or if the device does not support it.
    pub fn solve_with(&mut self, name: &str, iterations: Option<usize>) -> Result<()> {
        let weights = &self.weights;
        let optimizer = match name {
            "fnopt" => Optimizer::learned(weights.clone()),
            "fnopt-paper" => Optimizer::paper(weights.clone()),
            name => Optimizer::named(name, "solver", || Ok((**weights).clone()))?,
        };
        if let Some(weights) = optimizer.weights() {
            weights.config.check_grid(self.setup.model.grid, "the weights", "grid")?;
        }
        let iterations = iterations.unwrap_or(optimizer.default_iterations());
        self.settle()?;
        let model = Model { grid: self.setup.model.grid, cloths: vec![self.cloth()] };
        let parts = Parts::new(&self.context, &self.setup, &model, &optimizer, iterations)?;
        (self.solver, self.vertices, self.readback) = (parts.solver, parts.vertices, parts.readback);
        (self.cloth_mesh, self.optimizer, self.iterations) = (parts.mesh, optimizer, iterations);
        self.solver.set_state(&self.state);
        Ok(())
    }

    /// Goes back to the start. What the panel has changed stays; what the pointer has moved does not. Fails if the device is
    /// lost.
    pub fn reset(&mut self) -> Result<()> {
        self.settle()?;
        self.grip.clear();
        (self.frame, self.arrived, self.entered, self.broken, self.stats) = (0, 0, 0, None, None);
        self.anchors = Script::new(&self.setup).anchors().to_vec();
        self.handles = self.setup.handles[0].iter().map(|p| p.map(|c| c as f32)).collect();
        self.state = self.setup.start.cast();
        self.replace_cloth()?;
        self.solver.set_state(&self.state);
        Ok(())
    }

    /// Takes hold of a particle where it is. Fails if the device is lost.
    pub fn take(&mut self, particle: usize) -> Result<()> {
        self.settle()?;
        let n = self.setup.model.grid.particles();
        let at = DVec3::from([0, 1, 2].map(|c| f64::from(self.state.x[c * n + particle])));
        if self.grip.take(particle, at) && !self.script().cloth().handles.contains(&particle) {
            self.replace_cloth()?;
            // The markers of the other handles stay where they are.
            self.handles.push(at.as_vec3().to_array());
        }
        Ok(())
    }

    /// Moves the target of the particle that is held, to a place in metres along the scene's axes.
    pub fn drag(&mut self, to: Vec3) {
        self.grip.drag(DVec3::from(self.setup.handle_at::<f64>(to.as_dvec3().to_array())));
    }

    /// Lets go of the particle that is held; it stays where it is if it is to be `pinned`, or moves on with the scene if it is
    /// a handle of the scene. Fails if the cloth cannot be replaced.
    pub fn let_go(&mut self, pinned: bool) -> Result<()> {
        self.grip.let_go(pinned);
        self.tidy()
    }

    /// Whether particles stay pinned where they were let go.
    pub fn has_pinned(&self) -> bool {
        self.grip.has_pinned()
    }

    /// Lets go of the particles that stay pinned. Fails if the cloth cannot be replaced.
    pub fn unpin(&mut self) -> Result<()> {
        self.grip.unpin();
        self.tidy()
    }

    fn tidy(&mut self) -> Result<()> {
        let handles = self.script().cloth().handles.clone();
        let before = self.grip.extra(&handles);
        self.grip.tidy(&handles);
        let left = self.grip.extra(&handles);
        if before != left {
            // The places of those that stay, for their markers.
            let places = &self.handles[handles.len().min(self.handles.len())..];
            let stay = before.iter().zip(places).filter(|(particle, _)| left.contains(particle));
            let stay: Vec<[f32; 3]> = stay.map(|(_, place)| *place).collect();
            self.handles.truncate(handles.len());
            self.handles.extend(stay);
            self.replace_cloth()?;
        }
        Ok(())
    }

    /// Returns the recording that is in progress.
    pub(super) fn recorder(&self) -> Option<&Recorder> {
        self.recorder.as_ref()
    }

    /// Begins a recording of the frames that follow. Fails as [`Live::settle`] does.
    pub(super) fn record(&mut self, recorder: Recorder) -> Result<()> {
        self.settle()?;
        self.recorder = Some(recorder);
        Ok(())
    }

    /// Ends the recording, which has all frames so far. Fails as [`Live::settle`] does.
    pub(super) fn end_recording(&mut self) -> Result<Option<Recorder>> {
        self.settle()?;
        Ok(self.recorder.take())
    }

    /// Records the update of the vertices.
    pub(super) fn record_vertices(&self, encoder: &mut wgpu::CommandEncoder) {
        self.vertices.record(encoder);
    }

    /// Returns what is drawn of the cloth.
    pub(super) fn mesh(&self) -> &Mesh {
        &self.cloth_mesh
    }

    /// Returns the bodies that are there now, and whether each is a plane.
    pub(super) fn placed(&self) -> Vec<(&Mesh, Placed, bool)> {
        let there = self.bodies.there(self.frame);
        let placed = |(k, _, pose): (usize, _, _)| {
            let (mesh, patch) = &self.solids[k];
            let placed = Placed { columns: columns(pose), patch: patch.unwrap_or_default() };
            (mesh, placed, patch.is_some())
        };
        there.map(placed).collect()
    }

    /// Returns the markers of the handles, and of the place where the pointer wants the one that is dragged.
    pub(super) fn markers(&self) -> Vec<Marker> {
        let (units, up) = (&self.setup.units, self.setup.up);
        let marker = |at: [f64; 3], dragged: f32| {
            let [x, y, z] = up.from_z_up(units.position_m(at)).map(|c| c as f32);
            [x, y, z, dragged]
        };
        let handles = self.handles.iter().map(|at| marker(at.map(f64::from), 0.0));
        handles.chain(self.grip.dragged().map(|(_, target)| marker(target.to_array(), 1.0))).collect()
    }
}

/// What is built anew for another solver.
struct Parts {
    solver: Solver,
    vertices: Vertices,
    readback: Readback,
    mesh: Mesh,
}

impl Parts {
    fn new(
        context: &Context,
        setup: &Setup,
        model: &Model,
        optimizer: &Optimizer,
        iterations: usize,
    ) -> Result<Self> {
        if !optimizer.runs_on_gpu() {
            let expected = format!("one that runs on a GPU: {}", SOLVERS.join(", "));
            return Err(Error::invalid("view", "solver", expected, optimizer.name()));
        }
        let solver = Solver::new(context, model, optimizer, iterations)?;
        let readback = Readback::new(context, &solver.frame_tensors(), IN_FLIGHT)?;
        let grid = model.grid;
        let (vertices, faces, checker) = match &setup.embedding {
            Some(embedded) => {
                let faces = embedded.mesh.topology().triangles().collect();
                (solver.embedded_vertices(&embedded.embedding)?, faces, None)
            }
            None => (solver.vertices()?, model.cloths[0].faces(grid), Some([grid.h, grid.w])),
        };
        vertices.set_view(&setup.vertex_view());
        let buffer = vertices.tensor().buffer().clone();
        let mesh = Mesh::of_cloth(&context.device, buffer, &faces, checker);
        Ok(Self { solver, vertices, readback, mesh })
    }
}

/// Returns the cloth with all of its bodies present.
fn shown(cloth: &Cloth) -> Cloth {
    let mut cloth = cloth.clone();
    cloth.bodies.iter_mut().for_each(|body| body.present = true);
    cloth
}

/// Returns what a cloth with these particles needs around it.
fn room(places: &[[f32; 3]]) -> Room {
    let (low, high) = places
        .iter()
        .map(|&p| Vec3::from(p))
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    Room { middle: (low + high) / 2.0, size: (high - low).max_element().max(1e-3) }
}
