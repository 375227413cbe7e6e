//! Lists of dispatches with everything bound, recorded into a caller's encoder as often as needed.

use super::kernel::Program;
use super::tensor::Memory;
use super::work::{Walked, work};
use super::{Card, Context, Kernel, Profile, Tensor, Work};
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::Arc;

/// A sequence of dispatches and clears. It is built once; recording it makes no allocations of its own.
#[derive(Debug)]
pub struct Schedule {
    context: Context,
    steps: Vec<Step>,
    /// The bind groups created so far. Dispatches that bind the same resources share one, which leaves fewer
    /// to track while recording.
    bound: HashMap<Bound, wgpu::BindGroup>,
    /// The buffer that takes the parameters of the next dispatch.
    uniforms: Option<Uniforms>,
    /// Why the first dispatch beyond the device's limits was refused.
    refused: Option<String>,
}

/// What a dispatch binds, apart from the dynamic offset of its parameters.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Bound {
    layout: wgpu::BindGroupLayout,
    uniforms: wgpu::Buffer,
    /// Memory and size in bytes of each tensor.
    tensors: Vec<(Memory, u64)>,
}

/// A buffer with the parameters of many dispatches. Bound at different offsets, it is a single buffer to
/// track.
#[derive(Debug)]
struct Uniforms {
    buffer: wgpu::Buffer,
    /// Offset of each set of parameters in the buffer \[bytes\].
    known: HashMap<Vec<u8>, u32>,
    /// First free byte.
    end: u32,
}

/// Size of such a buffer \[bytes\]. The parameters of a frame of ten iterations fit; more of them take
/// further buffers.
const UNIFORMS: u32 = 1 << 15;

#[derive(Clone, Debug)]
enum Step {
    Dispatch(Dispatch),
    Clear { buffer: wgpu::Buffer, offset: u64, bytes: u64 },
}

#[derive(Clone, Debug)]
struct Dispatch {
    program: Arc<Program>,
    bind_group: wgpu::BindGroup,
    /// Offset of its parameters in their buffer.
    params: u32,
    /// The parameters.
    bytes: Box<[u8]>,
    groups: [u32; 3],
}

impl Dispatch {
    /// Records it, compiling its kernel if [`Schedule::finish`] has not. Panics if that fails.
    fn record(&self, pass: &mut wgpu::ComputePass<'_>, context: &Context) {
        let Self { program, bind_group, params, groups: [x, y, z], .. } = self;
        pass.set_pipeline(program.pipeline(context).unwrap_or_else(|e| panic!("{}.wgsl: {e}", program.name)));
        pass.set_bind_group(0, bind_group, &[*params]);
        pass.dispatch_workgroups(*x, *y, *z);
    }
}

impl Schedule {
    /// Creates an empty schedule for the device of `context`.
    pub fn new(context: &Context) -> Self {
        Self {
            context: context.clone(),
            steps: Vec::new(),
            bound: HashMap::new(),
            uniforms: None,
            refused: None,
        }
    }

    /// Appends a dispatch. `params` becomes binding 0, and `tensors` the bindings after it, in the WGSL's
    /// order.
    ///
    /// Panics if the number of tensors, their storage format or the size of the parameters is not the
    /// kernel's: that is a bug in the host side, not bad input. If there are more workgroups than the device
    /// supports, [`Schedule::finish`] fails.
    pub(crate) fn dispatch<P: bytemuck::Pod>(
        &mut self,
        kernel: &Kernel,
        params: &P,
        tensors: &[&Tensor],
        groups: [u32; 3],
    ) {
        self.dispatch_bytes(kernel, bytemuck::bytes_of(params), tensors, groups);
    }

    /// The same for any type of parameters.
    fn dispatch_bytes(&mut self, kernel: &Kernel, bytes: &[u8], tensors: &[&Tensor], groups: [u32; 3]) {
        let (expected, program) = (&kernel.bindings, &kernel.program);
        let name = program.name;
        assert_eq!(expected.len(), 1 + tensors.len(), "bindings of {name}: {expected:?}");
        assert_eq!(expected[0].size as usize, bytes.len(), "size of the parameters of {name}");
        for (binding, tensor) in expected[1..].iter().zip(tensors) {
            let label = tensor.label();
            let fits = match tensor.memory() {
                Memory::Buffer { .. } => !binding.is_texture() && binding.storage == tensor.storage(),
                Memory::Texels(_) => binding.is_texture(),
            };
            assert!(fits, "{name}: {} from '{label}', {:?}", binding.name, tensor.storage());
        }
        let context = &self.context;
        let most = context.device.limits().max_compute_workgroups_per_dimension;
        if groups.iter().any(|&g| g > most) {
            let needs = format!("{name} needs {groups:?} workgroups for this grid and batch");
            self.refused.get_or_insert(format!(
                "{}: {needs}, and the device takes {most} along an axis",
                context.name()
            ));
            return;
        }
        if groups.contains(&0) {
            return;
        }
        let (uniforms, params) = Uniforms::place(&mut self.uniforms, context, bytes);
        let bound = Bound {
            layout: program.layout.clone(),
            uniforms: uniforms.clone(),
            tensors: tensors.iter().map(|t| (t.memory().clone(), t.bytes())).collect(),
        };
        let group = || Self::bind(context, program, (&uniforms, bytes.len()), tensors);
        let bind_group = self.bound.entry(bound).or_insert_with(group).clone();
        let dispatch = Dispatch { program: program.clone(), bind_group, params, bytes: bytes.into(), groups };
        self.steps.push(Step::Dispatch(dispatch));
    }

    /// Creates a bind group of the tensors and `bytes` bytes of parameters, wherever they begin in their
    /// buffer.
    fn bind(
        context: &Context,
        program: &Program,
        (uniforms, bytes): (&wgpu::Buffer, usize),
        tensors: &[&Tensor],
    ) -> wgpu::BindGroup {
        let label = Some(program.name);
        let size = std::num::NonZeroU64::new(bytes as u64);
        let params = wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer: uniforms, offset: 0, size });
        let resources = std::iter::once(params).chain(tensors.iter().map(|t| t.binding()));
        let entries: Vec<_> = resources
            .enumerate()
            .map(|(i, resource)| wgpu::BindGroupEntry { binding: i as u32, resource })
            .collect();
        let descriptor = wgpu::BindGroupDescriptor { label, layout: &program.layout, entries: &entries };
        context.device.create_bind_group(&descriptor)
    }

    /// Appends a command that zeroes the whole tensor.
    pub fn clear(&mut self, tensor: &Tensor) {
        let (offset, bytes) = (tensor.offset(), tensor.bytes());
        self.steps.push(Step::Clear { buffer: tensor.buffer().clone(), offset, bytes });
    }

    /// Returns the finished schedule, with its kernels compiled on all threads of the current rayon pool.
    /// Fails if a kernel does not compile, or a dispatch has more workgroups than the device supports.
    pub fn finish(mut self) -> Result<Self> {
        if let Some(why) = self.refused.take() {
            return Err(Error::Device(why));
        }
        let mut programs: Vec<&Arc<Program>> = self.programs().collect();
        programs.sort_unstable_by_key(|program| Arc::as_ptr(program));
        programs.dedup_by(|a, b| Arc::ptr_eq(a, b));
        let context = &self.context;
        let compile = |program: &Arc<Program>| program.pipeline(context).map(|_| ());
        let compiled = programs.into_par_iter().try_for_each(compile);
        compiled.inspect_err(|_| context.kernels.clear())?;
        Ok(self)
    }

    /// Returns the program of each dispatch, in order.
    fn programs(&self) -> impl Iterator<Item = &Arc<Program>> {
        self.steps.iter().filter_map(|step| match step {
            Step::Dispatch(dispatch) => Some(&dispatch.program),
            Step::Clear { .. } => None,
        })
    }

    /// Returns the number of dispatches.
    pub fn dispatches(&self) -> usize {
        self.programs().count()
    }

    /// Returns the names of the kernels, each once, in the order of their first dispatch.
    pub fn kernels(&self) -> Vec<&'static str> {
        let mut names = Vec::new();
        for program in self.programs() {
            if !names.contains(&program.name) {
                names.push(program.name);
            }
        }
        names
    }

    /// Returns the kernel and the work of each dispatch, in order, in cycles of `card`; see [`Card::seconds`]. Empty in a browser.
    pub fn work(&self, card: &Card) -> Vec<(&'static str, Work)> {
        // Most dispatches of a frame are repeated in each iteration.
        let mut known: HashMap<(*const Program, &[u8], [u32; 3]), Work> = HashMap::new();
        let mut all = Vec::new();
        for step in &self.steps {
            let Step::Dispatch(Dispatch { program, bytes, groups, .. }) = step else { continue };
            let Some(module) = program.module() else { continue };
            let walk = || {
                let walked = Walked { module, constants: &program.constants, params: bytes, groups: *groups };
                work(&walked, card.latencies)
            };
            let key = (Arc::as_ptr(program), &**bytes, *groups);
            all.push((program.name, *known.entry(key).or_insert_with(walk)));
        }
        all
    }

    /// Returns the dispatches of one kernel alone, to measure it.
    pub fn only(&self, kernel: &str) -> Self {
        let wanted = |s: &&Step| matches!(s, Step::Dispatch(dispatch) if dispatch.program.name == kernel);
        let steps = self.steps.iter().filter(wanted).cloned().collect();
        Self { steps, ..Self::new(&self.context) }
    }

    /// Records everything into the caller's encoder. Consecutive dispatches share one compute pass.
    ///
    /// Kernels that [`Schedule::finish`] has not compiled are compiled here. Panics if that fails.
    pub fn record(&self, encoder: &mut wgpu::CommandEncoder) {
        let mut steps = self.steps.iter().peekable();
        while let Some(step) = steps.peek() {
            if let Step::Clear { buffer, offset, bytes } = step {
                encoder.clear_buffer(buffer, *offset, Some(*bytes));
                steps.next();
                continue;
            }
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("fnopt"),
                timestamp_writes: None,
            });
            while let Some(Step::Dispatch(dispatch)) = steps.next_if(|s| matches!(s, Step::Dispatch(_))) {
                dispatch.record(&mut pass, &self.context);
            }
        }
    }

    /// Records everything, with each dispatch in a separate pass timed by `profile`.
    ///
    /// The passes keep dispatches from overlapping, so the sum is an upper bound on the time of an untimed
    /// run.
    pub fn record_timed(&self, encoder: &mut wgpu::CommandEncoder, profile: &mut Profile) {
        for step in &self.steps {
            match step {
                Step::Clear { buffer, offset, bytes } => encoder.clear_buffer(buffer, *offset, Some(*bytes)),
                Step::Dispatch(dispatch) => {
                    let name = dispatch.program.name;
                    let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                        label: Some(name),
                        timestamp_writes: profile.next(name),
                    });
                    dispatch.record(&mut pass, &self.context);
                }
            }
        }
        profile.resolve(encoder);
    }
}

impl Uniforms {
    /// Returns the buffer that holds `params`, writing them if necessary, and their offset in it. `last` is
    /// the buffer in use.
    fn place(last: &mut Option<Self>, context: &Context, params: &[u8]) -> (wgpu::Buffer, u32) {
        let bytes = params.len() as u32;
        let takes = |uniforms: &Self| uniforms.known.contains_key(params) || uniforms.end + bytes <= UNIFORMS;
        let Self { buffer, known, end } = match last {
            Some(uniforms) if takes(uniforms) => uniforms,
            _ => last.insert(Self::new(context)),
        };
        let offset = *known.entry(params.to_vec()).or_insert_with(|| {
            let step = context.device.limits().min_uniform_buffer_offset_alignment;
            context.queue.write_buffer(buffer, u64::from(*end), params);
            std::mem::replace(end, (*end + bytes).next_multiple_of(step))
        });
        (buffer.clone(), offset)
    }

    fn new(context: &Context) -> Self {
        let buffer = context.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("parameters"),
            size: UNIFORMS.into(),
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        // As with tensors: otherwise wgpu would check for uninitialized memory in every dispatch.
        context.submit(|encoder| encoder.clear_buffer(&buffer, 0, None));
        Self { buffer, known: HashMap::new(), end: 0 }
    }
}
