//! Frames on any device, submitted and read back.

use crate::cloth::{Cloth, Control, Model, State};
use crate::device::{Device, DeviceChoice, Opened};
use crate::gpu::{Context, Readback, Storage};
use crate::scene::Course;
use crate::sim::{FrameStats, Memory, Optimizer, Solver};
use crate::{Error, Result, cpu};
use std::iter::Peekable;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// A batch of cloths that advances frame by frame: a convenience layer over [`Solver`] and [`cpu::Solver`].
///
/// ```
/// use fnopt::scene::Scene;
/// use fnopt::sim::Optimizer;
/// use fnopt::{Device, Simulator};
///
/// let setup = Scene::released().setup()?;
/// let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::lbfgs(), 5)?;
/// simulator.set_state(&setup.start.cast());
/// let frame = simulator.step(&setup.control(1))?;
/// assert!(frame.stats[0].gradient_last < frame.stats[0].gradient_first);
/// # Ok::<(), fnopt::Error>(())
/// ```
pub struct Simulator {
    backend: Backend,
    frame: usize,
}

enum Backend {
    Cpu { solver: Box<cpu::Solver<f32>>, state: State<f32> },
    Gpu { context: Context, solver: Box<Solver>, readback: Box<Readback> },
}

/// One frame of a batch.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct Frame {
    /// Number of the frame; the start state is 0.
    pub index: usize,
    /// State at the end of the frame.
    pub state: State<f32>,
    /// Statistics of each cloth.
    pub stats: Vec<FrameStats>,
    /// Wall time since the frame began; in a rollout on a GPU, since the previous frame arrived.
    pub wall: Duration,
}

/// Frames in flight on a GPU: one is computed while the previous one is read back.
const IN_FLIGHT: usize = 2;

impl Simulator {
    /// Builds a solver with `iterations` iterations per frame. The cloths start at rest.
    ///
    /// Fails if the model ([`Model::check`]) or the optimizer is not valid, there are no iterations, memory
    /// runs out, or the device is lost or does not support the optimizer, grid or batch.
    pub fn new(device: &Device, model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        let backend = match device {
            Device::Cpu => Backend::Cpu {
                solver: Box::new(cpu::Solver::new(model, optimizer, iterations)?),
                state: State::rest(model.grid, model.batch()),
            },
            Device::Gpu(context) => {
                let solver = Solver::new(context, model, optimizer, iterations)?;
                let readback = Box::new(Readback::new(context, &solver.frame_tensors(), IN_FLIGHT)?);
                Backend::Gpu { context: context.clone(), solver: Box::new(solver), readback }
            }
        };
        Ok(Self { backend, frame: 0 })
    }

    /// Opens the device of a choice and builds a solver there as [`Simulator::new`] does. Where the choice is open, the CPU takes the
    /// place of a GPU whose driver or memory is not up to it, with a warning, but for networks in half precision, which the CPU lacks.
    ///
    /// Fails as [`DeviceChoice::open`] and [`Simulator::new`] do.
    pub fn on(
        choice: &DeviceChoice,
        model: &Model,
        optimizer: &Optimizer,
        iterations: usize,
    ) -> Result<(Self, Opened)> {
        let gives_way = choice.is_open() && choice.storage == Storage::F32;
        Self::on_opened(choice.open_for(optimizer)?, gives_way, model, (optimizer, iterations))
    }

    fn on_opened(
        opened: Opened,
        gives_way: bool,
        model: &Model,
        (optimizer, iterations): (&Optimizer, usize),
    ) -> Result<(Self, Opened)> {
        match Self::new(&opened.device, model, optimizer, iterations) {
            Err(Error::Device(error) | Error::Lost(error))
                if gives_way && matches!(opened.device, Device::Gpu(_)) =>
            {
                tracing::warn!("{error}");
                let opened = Opened { device: Device::Cpu, why: "the hardware adapter cannot run this" };
                Ok((Self::new(&opened.device, model, optimizer, iterations)?, opened))
            }
            created => created.map(|simulator| (simulator, opened)),
        }
    }

    /// Replaces the state, resets the optimizer's memory and counts frames from 0 again.
    ///
    /// Panics if a length does not match the model.
    pub fn set_state(&mut self, start: &State<f32>) {
        self.frame = 0;
        match &mut self.backend {
            Backend::Cpu { solver, state } => {
                assert_eq!((start.x.len(), start.v.len()), (state.x.len(), state.v.len()), "[B, 3, H, W]");
                solver.reset_memory();
                state.clone_from(start);
            }
            Backend::Gpu { solver, .. } => solver.set_state(start),
        }
    }

    /// Goes on from `frame` of an earlier simulation: replaces the state and the optimizer's memory by those at its end
    /// ([`Simulator::state`], [`Simulator::memory`]). On the same device the frames that follow have the bits of an
    /// unbroken simulation. Fails, and changes nothing, if the memory is not that of such an optimizer.
    ///
    /// Panics if a length of the state does not match the model.
    pub fn resume(&mut self, frame: usize, state: &State<f32>, memory: &Memory) -> Result<()> {
        match &mut self.backend {
            Backend::Cpu { solver, .. } => solver.set_memory(memory)?,
            Backend::Gpu { solver, .. } => solver.set_memory(memory)?,
        }
        self.set_state(state);
        self.frame = frame;
        // Setting the state has reset it.
        match &mut self.backend {
            Backend::Cpu { solver, .. } => solver.set_memory(memory),
            Backend::Gpu { solver, .. } => solver.set_memory(memory),
        }
    }

    /// Returns what the optimizer remembers from frame to frame. Waits for a GPU. Fails if the device is lost.
    pub fn memory(&mut self) -> Result<Memory> {
        match &mut self.backend {
            Backend::Cpu { solver, .. } => Ok(solver.memory()),
            Backend::Gpu { solver, .. } => solver.memory(),
        }
    }

    /// Returns the number of the last frame that was computed, also of those that nobody received.
    pub fn frame(&self) -> usize {
        self.frame
    }

    /// Replaces the state of cloth `b` alone and resets the optimizer's memory of it. The others continue,
    /// even after an [`Error::NonFinite`] that names `b`. The frame count continues.
    ///
    /// Panics if a length is not that of one cloth, or if there is no cloth `b`.
    pub fn set_cloth_state(&mut self, b: usize, start: &State<f32>) {
        match &mut self.backend {
            Backend::Cpu { solver, state } => {
                solver.reset_memory_of(b);
                let len = state.x.len() / solver.model().batch();
                assert_eq!((start.x.len(), start.v.len()), (len, len), "[3, H, W]");
                for (all, own) in [(&mut state.x, &start.x), (&mut state.v, &start.v)] {
                    all[b * len..(b + 1) * len].copy_from_slice(own);
                }
            }
            Backend::Gpu { solver, .. } => solver.set_cloth_state(b, start),
        }
    }

    /// Replaces the cloths' materials, gravity, air, repulsion or handles. The next control sets the
    /// positions of the handles.
    ///
    /// Fails as [`Solver::set_cloths`] or [`cpu::Solver::set_cloths`] does.
    pub fn set_cloths(&mut self, cloths: &[Cloth]) -> Result<()> {
        match &mut self.backend {
            Backend::Cpu { solver, .. } => solver.set_cloths(cloths),
            Backend::Gpu { solver, .. } => solver.set_cloths(cloths),
        }
    }

    /// Returns the model.
    pub fn model(&self) -> &Model {
        match &self.backend {
            Backend::Cpu { solver, .. } => solver.model(),
            Backend::Gpu { solver, .. } => solver.model(),
        }
    }

    /// Returns the state on the device, also after a frame that is not finite. Waits for a GPU. Fails if the
    /// device is lost.
    pub fn state(&self) -> Result<State<f32>> {
        match &self.backend {
            Backend::Cpu { state, .. } => Ok(state.clone()),
            Backend::Gpu { context, solver, .. } => {
                Ok(State { x: solver.positions().read(context)?, v: solver.velocities().read(context)? })
            }
        }
    }

    /// Computes one frame and waits for it. Fails with [`Error::NonFinite`] if it is not finite (the state is
    /// then that of this frame; [`Simulator::set_state`] starts again), with [`Error::Lost`] if the device is
    /// lost, and if a length of the control does not match the model ([`Control::check`]).
    pub fn step(&mut self, control: &Control<f32>) -> Result<Frame> {
        let mut result = None;
        self.rollout(std::iter::once(control.clone()), |frame| {
            result = Some(frame);
            ControlFlow::Continue(())
        })?;
        Ok(result.expect("a control makes a frame"))
    }

    /// Computes a frame for each control and passes it to `take`, which may end the rollout.
    ///
    /// On a GPU the next frame is computed while `take` runs, so a rollout that ends early leaves the
    /// device's state up to one frame ahead: that frame counts, but nobody receives it.
    ///
    /// Fails with [`Error::NonFinite`] at the first frame that is not finite, after passing on the frames
    /// before it, with [`Error::Lost`] if the device is lost, and if a length of a control does not match the
    /// model ([`Control::check`]).
    pub fn rollout(
        &mut self,
        controls: impl IntoIterator<Item = Control<f32>>,
        mut take: impl FnMut(Frame) -> ControlFlow<()>,
    ) -> Result<()> {
        let mut controls = controls.into_iter().peekable();
        let mut begun = Instant::now();
        loop {
            let Some((state, stats)) = self.backend.next(&mut controls)? else { return Ok(()) };
            let now = Instant::now();
            self.frame += 1;
            let frame = Frame { index: self.frame, state, stats, wall: now - begun };
            frame.warn_if_unconverged();
            begun = now;
            if let Some(cloth) = frame.first_broken() {
                self.frame += self.backend.drain()?;
                return Err(Error::NonFinite { frame: frame.index, cloth });
            }
            let overflow = |of: &FrameStats| of.layers.and_then(|layers| layers.overflow);
            let mut overflows = frame.stats.iter().map(overflow).enumerate();
            if let Some((cloth, most)) = overflows.find_map(|(cloth, most)| Some((cloth, most?))) {
                self.frame += self.backend.drain()?;
                let origin = format!("frame {}, cloth {cloth}", frame.index);
                let expected = format!("{most} pairs of near parts for each particle at most");
                return Err(Error::invalid(
                    origin,
                    "self-contact",
                    expected,
                    "more: the cloth has collapsed",
                ));
            }
            if take(frame).is_break() {
                self.frame += self.backend.drain()?;
                return Ok(());
            }
            // On a GPU the next frame is already being computed.
            if let Backend::Cpu { .. } = self.backend {
                begun = Instant::now();
            }
        }
    }
}

impl Simulator {
    /// Computes the frames of a course that are left, that of a scene or of several together
    /// ([`Script`](crate::scene::Script), [`Scripts`](crate::scene::Scripts)), from the simulator's own state, and passes
    /// each to `take` as [`Simulator::rollout`] does, with the course as it is in that frame. Before the frames with changes
    /// ([`Setup::changes`](crate::scene::Setup::changes)) it waits for the state and replaces the cloths.
    ///
    /// Fails as [`Simulator::rollout`] and [`Simulator::set_cloths`] do.
    ///
    /// ```
    /// use fnopt::scene::{Scene, Script};
    /// use fnopt::sim::Optimizer;
    /// use fnopt::{Device, Simulator};
    /// use std::ops::ControlFlow;
    /// use std::path::Path;
    ///
    /// // A sheet that hangs from two corners, of which one is let go after half a second.
    /// let text = r#"{"frames": 60, "motion": "none", "events": [{"frame": 30, "release": [[0, 0]]}]}"#;
    /// let setup = Scene::parse(text, "a scene", Path::new(""))?.setup()?;
    /// let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &Optimizer::spectral(), 5)?;
    /// simulator.set_state(&setup.start.cast());
    /// let mut held = Vec::new();
    /// simulator.play(&mut Script::new(&setup), |script, _| {
    ///     held.push(script.cloth().handles.len());
    ///     ControlFlow::Continue(())
    /// })?;
    /// assert_eq!((held[28], held[29]), (2, 1));
    /// # Ok::<(), fnopt::Error>(())
    /// ```
    pub fn play<C: Course>(
        &mut self,
        course: &mut C,
        mut take: impl FnMut(&C, Frame) -> ControlFlow<()>,
    ) -> Result<()> {
        let frames = course.frames();
        let mut flow = ControlFlow::Continue(());
        while flow.is_continue() && self.frame + 1 < frames {
            let next = self.frame + 1;
            if course.next_change().is_some_and(|frame| frame <= next) {
                let start = self.state()?;
                if let Some(cloths) = course.enter(next, &start) {
                    self.set_cloths(&cloths)?;
                }
            }
            let end = course.next_change().map_or(frames, |change| change.min(frames));
            let course = &*course;
            self.rollout((next..end).map(|frame| course.control(frame)), |frame| {
                flow = take(course, frame);
                flow
            })?;
        }
        Ok(())
    }
}

impl Frame {
    fn warn_if_unconverged(&self) {
        for (cloth, stats) in
            self.stats.iter().enumerate().filter(|(_, stats)| stats.converged == Some(false))
        {
            let (frame, gradient) = (self.index, stats.gradient_last);
            tracing::warn!(
                "frame {frame}, cloth {cloth}: newton did not converge: |gradient| {gradient:.1e}"
            );
        }
    }

    /// Returns the first cloth that is not finite.
    fn first_broken(&self) -> Option<usize> {
        let per_cloth = self.state.x.len() / self.stats.len();
        let finite = |values: &[f32]| values.iter().all(|v| v.is_finite());
        (0..self.stats.len()).find(|&b| {
            let at = b * per_cloth..(b + 1) * per_cloth;
            !(self.stats[b].is_finite() && finite(&self.state.x[at.clone()]) && finite(&self.state.v[at]))
        })
    }
}

impl Backend {
    /// Returns the next frame, or `None` if there are no more controls.
    fn next(
        &mut self,
        controls: &mut Peekable<impl Iterator<Item = Control<f32>>>,
    ) -> Result<Option<(State<f32>, Vec<FrameStats>)>> {
        match self {
            Self::Cpu { solver, state } => {
                let Some(control) = controls.next() else { return Ok(None) };
                control.check(solver.model())?;
                let stats = solver.step(state, &control);
                Ok(Some((state.clone(), stats)))
            }
            Self::Gpu { context, solver, readback } => {
                // A control that does not fit the model is refused after the frames before it.
                let mut checked = Ok(());
                while !readback.is_full() {
                    let Some(control) = controls.peek() else { break };
                    checked = control.check(solver.model());
                    if checked.is_err() {
                        break;
                    }
                    solver.set_control(control);
                    controls.next();
                    let submission = context.submit(|encoder| {
                        solver.record(encoder);
                        readback.record(encoder);
                    });
                    readback.submitted(&submission);
                }
                let next = readback.next(|bytes| solver.frame(bytes))?;
                next.map_or_else(|| checked.map(|()| None), |frame| Ok(Some(frame)))
            }
        }
    }

    /// Waits for the frames in flight, so that the next rollout does not receive them, and returns their
    /// number.
    fn drain(&mut self) -> Result<usize> {
        let mut frames = 0;
        if let Self::Gpu { readback, .. } = self {
            while readback.next(|_| ())?.is_some() {
                frames += 1;
            }
        }
        Ok(frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloth::Grid;
    use crate::gpu::AdapterChoice;
    use crate::scene::Scene;

    /// Software adapters refuse L-BFGS on this many particles.
    #[test]
    fn a_gpu_that_cannot_run_a_simulation_gives_way_only_where_the_choice_is_open() {
        let mut scene = Scene::default();
        scene.regrid(Grid { h: 500, w: 500 }).unwrap();
        let model = scene.setup().unwrap().model;
        let device = Device::Gpu(Context::headless(&AdapterChoice::Name("llvmpipe".into())).unwrap());
        let created = |gives_way| {
            let opened = Opened { device: device.clone(), why: "opened" };
            Simulator::on_opened(opened, gives_way, &model, (&Optimizer::lbfgs(), 1))
        };
        let (_, opened) = created(true).unwrap();
        assert!(matches!(opened.device, Device::Cpu), "{opened}");
        assert!(opened.to_string().ends_with("(the hardware adapter cannot run this)"), "{opened}");
        assert!(matches!(created(false), Err(Error::Device(_))));
    }
}
