//! One frame of a batch of cloths on a device, recorded into the caller's encoder.

use super::method::{Method, row, rows};
use super::{FrameStats, IterationLog, Memory, Optimizer, StepCounts, Vertices};
use crate::cloth::{Cloth, Control, Embedding, EnergyTerms, Model, State};
use crate::gpu::{Context, Schedule, Tensor};
use crate::kernels::cloth::{
    Begin, ClothContacts, ClothLayers, ClothTerms, Fields, Objective, Room, gradient,
};
use crate::kernels::optim::subspace_step::STATE;
use crate::{Error, Result};
use std::borrow::Cow;
use std::sync::atomic::{AtomicBool, Ordering};

/// Persistent scale of a fresh hidden state (paper section 3.3).
pub const INITIAL_SCALE: f32 = 0.05;

/// A solver on the caller's device: buffers, kernels and the prepared dispatches of a frame.
///
/// [`Solver::new`] fills buffers through the caller's queue and waits until the kernels are compiled. After
/// that, [`Solver::record`] records one frame into the caller's encoder. It submits, polls and maps nothing,
/// and it neither allocates nor creates bind groups. The positions stay in a buffer that can be bound as a
/// vertex buffer ([`Solver::positions`]); [`Solver::vertices`] creates one with normals.
///
/// ```no_run
/// # fn frames(context: &fnopt::gpu::Context) -> fnopt::Result<()> {
/// use fnopt::network::Weights;
/// use fnopt::scene::Scene;
/// use fnopt::sim::{Optimizer, Solver};
///
/// let setup = Scene::default().setup()?;
/// let optimizer = Optimizer::learned(Weights::shipped());
/// let solver = Solver::new(context, &setup.model, &optimizer, 10)?;
/// solver.set_state(&setup.start.cast());
/// for frame in 1..setup.frames() {
///     solver.set_control(&setup.control(frame));
///     context.submit(|encoder| solver.record(encoder)); // or into an encoder of the host
/// }
/// # Ok(())
/// # }
/// ```
#[derive(Debug)]
pub struct Solver {
    context: Context,
    model: Model,
    iterations: usize,
    objective: Objective,
    /// Handle targets, shape [handles, 3]: the beginning of those of the objective, which has room for every
    /// particle.
    targets: Tensor,
    /// Whether the objective's wind holds any.
    windy: AtomicBool,
    /// Whether the objective's control accelerations hold any.
    accelerated: AtomicBool,
    method: Method,
    /// Partial sums of squares of the gradient and the last step in each iteration, one row [S, parts, 2]
    /// each; see [`rows`].
    sums: Tensor,
    /// The rows of `sums` at a = 0 and of the last iteration.
    ends: [Tensor; 2],
    /// Read in place of the checks of the steps by optimizers that have none, and of the reports of bodies and layers.
    unchecked: Tensor,
    frame: Schedule,
}

impl Solver {
    /// Creates buffers and kernels and builds the schedule of a frame of `iterations` iterations (N), with the
    /// context's tile sizes ([`Context::tuning`]). The cloths start at rest ([`State::rest`]).
    ///
    /// Fails if the model is not valid ([`Model::check`]), there are no iterations, a kernel does not compile,
    /// memory runs out, the device is lost, or it does not support the optimizer, grid or batch.
    pub fn new(context: &Context, model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        context.checked(|| Self::build(context, model, optimizer, iterations))
    }

    fn build(context: &Context, model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Self> {
        model.check()?;
        optimizer.check()?;
        if iterations == 0 {
            return Err(Error::invalid("solver", "iterations", "at least 1", 0));
        }
        let (grid, batch) = (model.grid, model.batch());
        let method = Method::new(context, optimizer, &context.tuning(), (model, iterations))?;
        let room = Room {
            handles: batch * grid.particles(),
            repulsion: model.repels(),
            self_contact: model.touches_itself(),
            bodies: model.cloths.iter().map(|cloth| cloth.bodies.len()).max().unwrap_or(0),
            fields: Fields::of(model).words_count(),
            rest_angles: model.has_rest_angles(),
            hidden: method.scales().is_some(),
        };
        let objective = Objective::new(context, grid, batch, room)?;
        objective.set_cloths(model);
        method.set_cloths(context, model);
        let of_squares = [3 * batch, gradient::parts(grid), 2];
        // One more, the last, if there is a gradient before the first iteration.
        let starts_before = method.checks_energy();
        let count = iterations + usize::from(starts_before);
        let sums = rows(context, "sums of squares", count, of_squares.iter().product())?;
        let first = if starts_before { iterations } else { 0 };
        let ends = [first, iterations - 1].map(|iteration| row(&sums, iteration, &of_squares));
        let mut solver = Self {
            context: context.clone(),
            model: model.clone(),
            iterations,
            targets: objective.targets.view(0, &[model.handles(), 3]),
            objective,
            windy: AtomicBool::new(false),
            accelerated: AtomicBool::new(false),
            method,
            sums,
            ends,
            unchecked: Tensor::zeros(context, "unchecked", &[1, batch, STATE])?,
            frame: Schedule::new(context),
        };
        solver.frame = solver.build_schedule()?;
        solver.set_state(&State::rest(grid, batch));
        Ok(solver)
    }

    /// Builds the schedule of one frame, in the order given in the crate's documentation.
    fn build_schedule(&self) -> Result<Schedule> {
        let Self { objective, method, .. } = self;
        let mut frame = Schedule::new(&self.context);
        let [before, _] = &self.ends;
        // Where the accelerations of the frame before are a direction, it is the method that clears them.
        let begin = if method.checks_energy() { Begin::Kept } else { Begin::Zero };
        objective.begin_frame(&mut frame, begin)?;
        if method.checks_energy() {
            method.push_begin(&mut frame, objective);
            objective.evaluate(&mut frame, before);
            method.push_start(&mut frame, objective);
        }
        for iteration in 0..self.iterations {
            let sums = row(&self.sums, iteration, before.shape());
            if !method.checks_energy() {
                objective.confine(&mut frame, None);
            }
            objective.evaluate(&mut frame, &sums);
            method.push(&mut frame, objective, iteration, &sums);
        }
        method.push_end(&mut frame, objective);
        objective.part_layers(&mut frame);
        objective.energy(&mut frame);
        objective.end_frame(&mut frame);
        frame.finish()
    }

    /// Records one frame. It reads the state and control present when the encoder runs, and replaces the
    /// state with the next one.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        self.frame.record(encoder);
    }

    /// Returns the dispatches of one frame.
    pub fn schedule(&self) -> &Schedule {
        &self.frame
    }

    /// Returns the model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Returns the number of iterations per frame (N).
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// Returns the positions \[edges\], shape [B, 3, H W]. Their buffer can be bound for storage and as a
    /// vertex buffer.
    pub fn positions(&self) -> &Tensor {
        &self.objective.x
    }

    /// Returns what each particle is ([`crate::cloth::Mark`]), shape [B, H W].
    pub(super) fn marks(&self) -> &Tensor {
        &self.objective.iterate.marks
    }

    /// Returns the velocities [edges / frame], shape [B, 3, H W].
    pub fn velocities(&self) -> &Tensor {
        &self.objective.v
    }

    /// Returns the accelerations of the last frame [edges / frame^2], shape [B, 3, H W].
    pub fn accelerations(&self) -> &Tensor {
        &self.objective.iterate.a
    }

    /// Returns the handle targets \[edges\] of the next frame, in the order of [`Control::handles`], shape
    /// [handles, 3]. [`Solver::set_control`] writes them. Commands of the host that run between that and the
    /// frame may overwrite them, for example with a copy of the position of a particle that is to stay where
    /// it is.
    pub fn handle_targets(&self) -> &Tensor {
        &self.targets
    }

    /// Returns the external accelerations of the next frame [edges / frame^2], shape [B, 3, H W]. Commands of
    /// the host may write here. What they write acts in every frame, as long as no control has accelerations.
    /// Those of a control are cleared by the next control without any; if [`Solver::record_frames`] took
    /// them, by every control without any, up to and including the next [`Solver::set_control`].
    pub fn control_accelerations(&self) -> &Tensor {
        &self.objective.control_accelerations
    }

    /// Replaces the state, holds the handles at their positions in it and resets the optimizer's memory,
    /// ahead of the next submission. Wind and accelerations keep their values. A later control sets all
    /// three.
    ///
    /// Panics if a length does not match the model.
    pub fn set_state(&self, state: &State<f32>) {
        self.replace_state(state);
        self.targets.write(&self.context, &self.handles_of(state));
        self.reset_memory();
    }

    /// Applies [`Solver::set_state`] to cloth `b` alone; the others continue. Panics if a length is not that
    /// of one cloth, or if there is no cloth `b`.
    pub fn set_cloth_state(&self, b: usize, state: &State<f32>) {
        let (batch, n) = (self.model.batch(), self.model.grid.particles());
        assert!(b < batch, "cloth {b} of {batch}");
        assert_eq!((state.x.len(), state.v.len()), (3 * n, 3 * n), "[3, H, W]");
        self.objective.x.write_at(&self.context, 3 * b * n, &state.x);
        self.objective.v.write_at(&self.context, 3 * b * n, &state.v);
        let handles: Vec<_> =
            self.model.cloths[b].handles.iter().map(|&p| particle(&state.x, n, p)).collect();
        self.targets.write_at(
            &self.context,
            3 * self.model.handle_range(b).start,
            bytemuck::cast_slice(&handles),
        );
        self.reset_memory_of(b);
    }

    /// Replaces the cloths' materials, gravity, air, repulsion or handles, ahead of the next submission. Wind
    /// and accelerations keep their values. If the handles of any cloth change, all handles are held where they
    /// are, until a control moves them.
    ///
    /// Fails, and changes nothing, if the number of cloths differs, if they are not valid ([`Model::check`]), if the device has too little
    /// memory for more handles, or if one has a repulsion, touches itself, has angles at rest, or has more bodies or larger meshes than any
    /// had, although the solver was built without room for them, which requires a new solver.
    pub fn set_cloths(&mut self, cloths: &[Cloth]) -> Result<()> {
        let model = self.model.with_cloths(cloths)?;
        if !self.objective.has_room_for_repulsion() {
            model.refuse_repulsion("since the solver was built without")?;
        }
        if !self.objective.has_room_for_self_contact() {
            model.refuse_self_contact("since the solver was built without")?;
        }
        if !self.objective.has_room_for_rest_angles() {
            model.refuse_rest_angles("since the solver was built without")?;
        }
        let room = self.objective.room_for_bodies();
        if let Some(b) = model.cloths.iter().position(|cloth| cloth.bodies.len() > room) {
            let expected = format!("{room} at most, for which the solver was built");
            let found = model.cloths[b].bodies.len();
            return Err(Error::invalid("model", format!("bodies of cloth {b}"), expected, found));
        }
        let (room, found) = (self.objective.room_for_fields(), Fields::of(&model).words_count());
        if found > room {
            let expected = format!("meshes of {room} samples at most, for which the solver was built");
            return Err(Error::invalid("model", "bodies", expected, format!("{found} samples")));
        }
        self.make_room(&model)?;
        let mut each = model.cloths.iter().zip(&self.model.cloths);
        let handles_differ = each.any(|(new, old)| new.handles != old.handles);
        if handles_differ {
            self.targets = self.objective.targets.view(0, &[model.handles(), 3]);
        }
        self.objective.set_cloths(&model);
        self.method.set_cloths(&self.context, &model);
        self.model = model;
        if handles_differ {
            self.hold_handles();
        }
        Ok(())
    }

    /// Makes room for the handles of these cloths if they take more than there is. Fails, and changes nothing, if the device has too little
    /// memory.
    fn make_room(&mut self, model: &Model) -> Result<()> {
        let context = self.context.clone();
        let Some(room) = context.checked(|| self.method.room_for(&context, model))? else { return Ok(()) };
        let before = self.method.replace_room(room);
        match context.checked(|| self.build_schedule()) {
            Ok(frame) => {
                self.frame = frame;
                Ok(())
            }
            Err(error) => {
                self.method.replace_room(before);
                Err(error)
            }
        }
    }

    /// Copies the positions of the handles to their targets, on the device.
    fn hold_handles(&self) {
        let n = self.model.grid.particles();
        let handles = self.model.cloths.iter().enumerate();
        let handles = handles.flat_map(|(b, cloth)| cloth.handles.iter().map(move |p| 3 * b * n + p));
        self.context.submit(|encoder| {
            for (handle, first) in handles.enumerate() {
                for c in 0..3 {
                    let [from, to] = [first + c * n, 3 * handle + c].map(|at| 4 * at as u64);
                    let (x, targets) = (self.objective.x.buffer(), self.targets.buffer());
                    encoder.copy_buffer_to_buffer(x, from, targets, self.targets.offset() + to, 4);
                }
            }
        });
    }

    /// Replaces the state but keeps the optimizer's memory and the handle targets, ahead of the next
    /// submission.
    ///
    /// Panics if a length does not match the model, as [`Solver::set_state`] does.
    pub fn replace_state(&self, state: &State<f32>) {
        self.objective.x.write(&self.context, &state.x);
        self.objective.v.write(&self.context, &state.v);
    }

    /// Resets what the optimizer remembers from frame to frame: the hidden state of a network, and the accelerations
    /// of the last two frames.
    pub fn reset_memory(&self) {
        if let Some(earlier) = self.method.earlier() {
            let zeros = vec![0f32; earlier.len()];
            self.objective.iterate.a.write(&self.context, &zeros);
            earlier.write(&self.context, &zeros);
        }
        if let (Some(scales), Some(hidden)) = (self.method.scales(), &self.objective.iterate.hidden) {
            hidden.write(&self.context, &vec![0f32; hidden.len()]);
            scales.write(&self.context, &vec![INITIAL_SCALE; scales.len()]);
        }
    }

    /// Returns what the optimizer remembers from frame to frame. Waits for the device. Fails if it is lost.
    pub fn memory(&self) -> Result<Memory> {
        let mut memory = Memory::default();
        if let Some(earlier) = self.method.earlier() {
            memory.accelerations = self.objective.iterate.a.read(&self.context)?;
            memory.accelerations.append(&mut earlier.read(&self.context)?);
        }
        if let (Some(scales), Some(hidden)) = (self.method.scales(), &self.objective.iterate.hidden) {
            memory.hidden = hidden.read(&self.context)?;
            // A frame starts from the last row.
            let rows: Vec<f32> = scales.read(&self.context)?;
            memory.scales = rows[rows.len() - scales.shape()[1]..][..3 * self.model.batch()].to_vec();
        }
        Ok(memory)
    }

    /// Replaces what the optimizer remembers, ahead of the next submission. Fails, and changes nothing, if it is not
    /// that of such an optimizer ([`Solver::memory`]), or not finite.
    pub fn set_memory(&self, memory: &Memory) -> Result<()> {
        let mut expected = Memory::default();
        let (a, scales) = (&self.objective.iterate.a, self.method.scales());
        if self.method.earlier().is_some() {
            expected.accelerations = vec![0.0; 2 * a.len()];
        }
        if let (Some(_), Some(hidden)) = (scales, &self.objective.iterate.hidden) {
            expected.hidden = vec![0.0; hidden.len()];
            expected.scales = vec![0.0; 3 * self.model.batch()];
        }
        memory.check(&expected)?;
        if let Some(earlier) = self.method.earlier() {
            let (last, before) = memory.accelerations.split_at(a.len());
            a.write(&self.context, last);
            earlier.write(&self.context, before);
        }
        if let (Some(scales), Some(hidden)) = (scales, &self.objective.iterate.hidden) {
            hidden.write(&self.context, &memory.hidden);
            for row in (0..scales.len()).step_by(scales.shape()[1]) {
                scales.write_at(&self.context, row, &memory.scales);
            }
        }
        Ok(())
    }

    /// Applies [`Solver::reset_memory`] to cloth `b` alone. Panics if there is no such cloth.
    pub fn reset_memory_of(&self, b: usize) {
        let (batch, n) = (self.model.batch(), self.model.grid.particles());
        assert!(b < batch, "cloth {b} of {batch}");
        if let Some(earlier) = self.method.earlier() {
            let zeros = vec![0f32; 3 * n];
            self.objective.iterate.a.write_at(&self.context, 3 * b * n, &zeros);
            earlier.write_at(&self.context, 3 * b * n, &zeros);
        }
        if let (Some(scales), Some(hidden)) = (self.method.scales(), &self.objective.iterate.hidden) {
            for half in [0, 3 * batch * n] {
                hidden.write_at(&self.context, half + 3 * b * n, &vec![0.0; 3 * n]);
            }
            for row in (0..scales.len()).step_by(scales.shape()[1]) {
                scales.write_at(&self.context, row + 3 * b, &[INITIAL_SCALE; 3]);
            }
        }
    }

    /// Sets the control of the frames from the next one on, ahead of the next submission: until another
    /// control, handles stay at their targets, and wind and accelerations keep acting. Of several calls
    /// before a submission only the last counts; [`Solver::record_frames`] takes a control for each frame.
    ///
    /// Panics if a length does not match the model ([`Control::check`]).
    pub fn set_control(&self, control: &Control<f32>) {
        for (tensor, bytes) in self.changes(control) {
            tensor.write(&self.context, &bytes);
        }
        self.windy.store(!control.wind.is_empty(), Ordering::Relaxed);
        self.accelerated.store(!control.external.is_empty(), Ordering::Relaxed);
    }

    /// Records a frame for each control, so that one submission advances them all. Intermediate states are
    /// not kept. The controls travel with the encoder, in a buffer of their own: submit it before you set or
    /// record another one.
    ///
    /// Fails if there is no memory for the controls, or if the device is lost. Panics if a length does not
    /// match the model ([`Control::check`]).
    pub fn record_frames(&self, encoder: &mut wgpu::CommandEncoder, controls: &[Control<f32>]) -> Result<()> {
        let changes: Vec<_> = controls.iter().map(|control| self.changes(control)).collect();
        let contents: Vec<u8> =
            changes.iter().flatten().flat_map(|(_, bytes)| bytes.iter().copied()).collect();
        let uploads = self.context.upload("controls", &contents)?;
        let mut from = 0;
        for changes in changes {
            for (tensor, bytes) in changes.iter().filter(|(_, bytes)| !bytes.is_empty()) {
                let count = bytes.len() as u64;
                encoder.copy_buffer_to_buffer(&uploads, from, tensor.buffer(), tensor.offset(), count);
                from += count;
            }
            self.record(encoder);
        }
        Ok(())
    }

    /// Returns the tensors that a control changes relative to the controls before it, with their new
    /// contents.
    fn changes<'a>(&'a self, control: &'a Control<f32>) -> Vec<(&'a Tensor, Cow<'a, [u8]>)> {
        let objective = &self.objective;
        control.check(&self.model).unwrap_or_else(|e| panic!("{e}"));
        let mut changes = vec![(&self.targets, Cow::from(bytemuck::cast_slice(&control.handles)))];
        if let Some((bodies, params)) = objective.bodies(&self.model, control) {
            changes.push((bodies, bytemuck::cast_slice(&params).to_vec().into()));
        }
        // A control without wind or accelerations clears those of earlier controls. A recorded control may
        // never be submitted, so recording only raises these flags; `set_control` also lowers them.
        let optional = [
            (&objective.wind, &self.windy, bytemuck::cast_slice(&control.wind)),
            (&objective.control_accelerations, &self.accelerated, bytemuck::cast_slice(&control.external)),
        ];
        for (tensor, set, bytes) in optional {
            let was_set = set.fetch_or(!bytes.is_empty(), Ordering::Relaxed);
            if !bytes.is_empty() {
                changes.push((tensor, Cow::from(bytes)));
            } else if was_set {
                changes.push((tensor, vec![0; tensor.bytes() as usize].into()));
            }
        }
        changes
    }

    /// Creates a vertex buffer of the cloths, with positions and normals. Its view is
    /// [`VertexView::default`](crate::cloth::VertexView::default) until [`Vertices::set_view`] replaces it.
    /// Fails if the device cannot bind a buffer of that size.
    pub fn vertices(&self) -> Result<Vertices> {
        Vertices::new(&self.context, self, None)
    }

    /// Creates the same of a mesh that each cloth carries along: positions and normals are interpolated from those of the
    /// particles. Fails, too, if the embedding is in another grid or has no vertices.
    pub fn embedded_vertices(&self, embedding: &Embedding) -> Result<Vertices> {
        Vertices::new(&self.context, self, Some(embedding))
    }

    /// Returns the tensors that [`Solver::frame`] reads, for a [`Readback`](crate::gpu::Readback).
    pub fn frame_tensors(&self) -> [&Tensor; 8] {
        let [terms, first, last, steps, bodies, layers] = self.statistics_tensors();
        [&self.objective.x, &self.objective.v, terms, first, last, steps, bodies, layers]
    }

    /// Returns the state and the statistics of each cloth in the last frame, from the concatenated contents of
    /// [`Solver::frame_tensors`]. Panics on contents of another length.
    pub fn frame(&self, contents: &[u8]) -> (State<f32>, Vec<FrameStats>) {
        let (x, rest) = contents.split_at(self.objective.x.bytes() as usize);
        let (v, statistics) = rest.split_at(self.objective.v.bytes() as usize);
        let [x, v] = [x, v].map(bytemuck::pod_collect_to_vec);
        (State { x, v }, self.statistics(statistics))
    }

    /// Returns the tensors that [`Solver::statistics`] reads, in the order in which it expects their
    /// contents.
    pub fn statistics_tensors(&self) -> [&Tensor; 6] {
        let [first, last] = &self.ends;
        let steps = self.method.state().unwrap_or(&self.unchecked);
        [
            &self.objective.terms,
            first,
            last,
            steps,
            self.objective.contact_report().unwrap_or(&self.unchecked),
            self.objective.layer_report().unwrap_or(&self.unchecked),
        ]
    }

    /// Returns the statistics of each cloth in the last frame, from the concatenated contents of
    /// [`Solver::statistics_tensors`]. Panics on contents of another length.
    pub fn statistics(&self, contents: &[u8]) -> Vec<FrameStats> {
        let len: u64 = self.statistics_tensors().map(Tensor::bytes).iter().sum();
        assert_eq!(contents.len() as u64, len, "the contents of the tensors of statistics");
        let contents: Vec<f32> = bytemuck::pod_collect_to_vec(contents);
        let (terms, rest) = contents.split_at(self.objective.terms.len());
        let (ends, rest) = rest.split_at(2 * self.ends[0].len());
        let [.., steps, bodies, _] = self.statistics_tensors();
        let (steps, rest) = rest.split_at(steps.len());
        let (report, layers) = rest.split_at(bodies.len());
        let ends = self.gradient_norms(ends);
        let steps = &steps[steps.len() - STATE * self.model.batch()..];
        let (first, last) = ends.split_at(3 * self.model.batch());
        let of_cloth =
            |norms: &[f64], b: usize| norms[3 * b..][..3].iter().map(|g| g * g).sum::<f64>().sqrt();
        let contacts = |b: usize| {
            let of_cloth = report.len() / self.model.batch();
            ClothContacts::of(&report[b * of_cloth..][..of_cloth], self.model.cloths[b].bodies.len())
        };
        let layers = |b: usize| {
            self.model.cloths[b].self_contact?;
            let of_cloth = layers.len() / self.model.batch();
            Some(ClothLayers::of(&layers[b * of_cloth..][..of_cloth], self.model.grid.particles()))
        };
        let contact = |b: usize| contacts(b).energy + layers(b).map_or(0.0, |layers| layers.energy);
        let stats = |(b, terms): (usize, ClothTerms)| FrameStats {
            energy: EnergyTerms { contact: contact(b), ..terms.energy },
            gradient_first: of_cloth(first, b),
            gradient_last: of_cloth(last, b),
            stretch_largest: terms.stretch_largest,
            stretch_mean: terms.stretch_sum / self.model.cloths[b].edges(self.model.grid) as f64,
            converged: None,
            steps: step_counts(&steps[b * STATE..][..STATE]),
            bodies: contacts(b).bodies,
            layers: layers(b).map(|layers| layers.stats),
        };
        ClothTerms::all(terms).enumerate().map(stats).collect()
    }

    /// Returns the gradient norms of samples from their partial sums of squares, [.., parts, 2].
    fn gradient_norms(&self, sums: &[f32]) -> Vec<f64> {
        let norm = |parts: &[f32]| parts.iter().step_by(2).map(|&s| f64::from(s)).sum::<f64>().sqrt();
        sums.chunks_exact(2 * gradient::parts(self.model.grid)).map(norm).collect()
    }

    /// Returns a log of the optimizer's iterations in the last frame. Means nothing before the first frame, and
    /// after a reset of the optimizer's memory until the next one. Waits for the device, so it is meant for
    /// checks, not for use in every frame.
    pub fn iteration_log(&self) -> Result<IterationLog> {
        let mut scales = Vec::new();
        if let Some(rows) = self.method.scales() {
            for row in rows.read::<f32>(&self.context)?.chunks_exact(rows.shape()[1]) {
                scales.extend(row[..3 * self.model.batch()].iter().map(|&s| f64::from(s)));
            }
        }
        let (sums, of_row) = (self.sums.read::<f32>(&self.context)?, self.ends[0].len());
        let rows = sums.chunks_exact(self.sums.shape()[1]).take(self.iterations);
        let gradient_norms = rows.flat_map(|row| self.gradient_norms(&row[..of_row])).collect();
        Ok(IterationLog { gradient_norms, scales })
    }

    /// Returns the handle positions in `state` [B, 3, n], in the order of [`Control::handles`]. Panics if a
    /// length does not match the model.
    pub fn handles_of(&self, state: &State<f32>) -> Vec<[f32; 3]> {
        let n = self.model.grid.particles();
        assert_eq!(state.x.len(), 3 * n * self.model.batch(), "[B, 3, H, W]");
        let cloths = self.model.cloths.iter().zip(state.x.chunks_exact(3 * n));
        cloths.flat_map(|(cloth, x)| cloth.handles.iter().map(move |&p| particle(x, n, p))).collect()
    }
}

/// Returns what became of the steps of a frame, from the last state of a cloth ([`Subspace::state`]).
///
/// [`Subspace::state`]: crate::kernels::optim::Subspace::state
fn step_counts(state: &[f32]) -> StepCounts {
    StepCounts { shortened: state[3] as usize, dropped: state[4] as usize }
}

/// Returns the position of particle `p` in a cloth of `n` particles with positions `x` [3, n].
fn particle(x: &[f32], n: usize, p: usize) -> [f32; 3] {
    [0, 1, 2].map(|c| x[c * n + p])
}
