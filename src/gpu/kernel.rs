//! Kernels: WGSL entry points with their bindings and pipelines.

use super::context::{BROWSER, WORKGROUPS};
use super::{Context, Source, Storage, Unroll};
use crate::{Error, Result};
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

/// A binding of group 0, as declared in the WGSL.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Name of the variable.
    pub name: String,
    /// Uniform, read-only or read-write storage, or a texture for a tensor in texels.
    pub ty: wgpu::BindingType,
    /// Size of the variable \[bytes\], or of one element of a runtime-sized array; 0 for a texture.
    pub size: u32,
    /// Storage format of the numbers; integers and structures count as 32-bit, and so do texels, which are
    /// widened when they are read.
    pub storage: Storage,
}

impl Binding {
    /// Whether it is a texture.
    pub fn is_texture(&self) -> bool {
        !matches!(self.ty, wgpu::BindingType::Buffer { .. })
    }
}

impl Source {
    fn parsed(&self, text: &str) -> Result<naga::Module> {
        naga::front::wgsl::parse_str(text)
            .map_err(|e| Error::Device(format!("{}.wgsl: {}", self.name, e.emit_to_string(text))))
    }

    /// Returns the bindings of group 0, in order.
    pub fn bindings(&self, module: &naga::Module) -> Vec<Binding> {
        let mut found: Vec<(u32, Binding)> = Vec::new();
        for (_, variable) in module.global_variables.iter() {
            let Some(place) = variable.binding else { continue };
            let size = module.types[variable.ty].inner.size(module.to_ctx());
            let buffer = |ty| wgpu::BindingType::Buffer {
                ty,
                // One buffer holds the parameters of many dispatches.
                has_dynamic_offset: place.binding == 0,
                // If known here, it is checked once per bind group instead of at every dispatch.
                min_binding_size: std::num::NonZeroU64::new(size.into()),
            };
            let ty = match variable.space {
                naga::AddressSpace::Uniform => buffer(wgpu::BufferBindingType::Uniform),
                naga::AddressSpace::Storage { access } => buffer(wgpu::BufferBindingType::Storage {
                    read_only: !access.contains(naga::StorageAccess::STORE),
                }),
                naga::AddressSpace::Handle => texels(module, variable.ty),
                other => unreachable!("{}.wgsl binds a variable in {other:?}", self.name),
            };
            let name = variable.name.clone().unwrap_or_default();
            found.push((place.binding, Binding { name, ty, size, storage: storage(module, variable.ty) }));
        }
        found.sort_by_key(|f| f.0);
        found.into_iter().map(|f| f.1).collect()
    }
}

/// Returns how a texture is bound: to be written if it has a format, else to be read.
fn texels(module: &naga::Module, ty: naga::Handle<naga::Type>) -> wgpu::BindingType {
    let view_dimension = wgpu::TextureViewDimension::D2;
    let naga::TypeInner::Image { class: naga::ImageClass::Storage { format, .. }, .. } =
        module.types[ty].inner
    else {
        return wgpu::BindingType::Texture {
            sample_type: wgpu::TextureSampleType::Float { filterable: false },
            view_dimension,
            multisampled: false,
        };
    };
    let storage = if format == naga::StorageFormat::Rgba16Float { Storage::F16 } else { Storage::F32 };
    let access = wgpu::StorageTextureAccess::WriteOnly;
    wgpu::BindingType::StorageTexture { access, format: storage.texels(), view_dimension }
}

/// Returns the storage format of the numbers in a type.
fn storage(module: &naga::Module, ty: naga::Handle<naga::Type>) -> Storage {
    match module.types[ty].inner {
        naga::TypeInner::Array { base, .. } => storage(module, base),
        naga::TypeInner::Vector { scalar, .. } | naga::TypeInner::Scalar(scalar) if scalar.width == 2 => {
            Storage::F16
        }
        _ => Storage::F32,
    }
}

/// A kernel of this crate, built once and pushed onto schedules as often as needed.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pub(super) bindings: Vec<Binding>,
    /// Invocations per workgroup along each axis, if the text fixes them.
    workgroup: Option<[u32; 3]>,
    pub(super) program: Arc<Program>,
}

/// The kernels built on a device, by their text and constants. All its solvers share them, since a pipeline
/// takes tens of milliseconds to compile. Those of solvers that are gone stay for the next ones, up to a limit.
#[derive(Clone, Debug, Default)]
pub(super) struct Kernels(Arc<Mutex<HashMap<KernelKey, Kernel>>>);

/// The text of a kernel and the bits of its constants.
type KernelKey = (String, Vec<(&'static str, u64)>);

/// Number of kernels from which on those that no solver uses are dropped: more than ten different solvers have.
const MOST_KERNELS: usize = 512;

impl Kernels {
    /// Forgets all kernels, so that the next solver does not get one that failed to compile.
    pub fn clear(&self) {
        self.lock().clear();
    }

    fn get(&self, key: &KernelKey) -> Option<Kernel> {
        self.lock().get(key).cloned()
    }

    fn insert(&self, key: KernelKey, kernel: &Kernel) {
        let mut known = self.lock();
        if known.len() >= MOST_KERNELS {
            known.retain(|_, kernel| Arc::strong_count(&kernel.program) > 1);
        }
        known.insert(key, kernel.clone());
    }

    fn lock(&self) -> MutexGuard<'_, HashMap<KernelKey, Kernel>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The part of a kernel that is compiled, once and only on first use: a kernel that a network or an optimizer
/// does not need costs no pipeline.
#[derive(Debug)]
pub(super) struct Program {
    pub name: &'static str,
    pub layout: wgpu::BindGroupLayout,
    source: wgpu::ShaderSource<'static>,
    pub constants: Vec<(&'static str, f64)>,
    /// The pipeline, or why it failed to compile, which is reported to everyone who waits for it.
    pipeline: OnceLock<Result<wgpu::ComputePipeline, String>>,
}

impl Kernel {
    /// Reads `source`, unrolled, to be compiled with `constants` for its overrides. Returns the existing
    /// kernel if it was already built on this device. Fails if the text does not parse.
    pub fn new(
        context: &Context,
        source: &Source,
        unroll: impl Into<Unroll>,
        constants: &[(&'static str, f64)],
    ) -> Result<Self> {
        let (unroll, order) = (unroll.into(), context.order());
        let sharing = order.sharing(unroll.sharing);
        let text = source.unrolled(Unroll { sharing, storage: context.storage(), order, ..unroll });
        let bits = constants.iter().map(|&(name, value)| (name, value.to_bits())).collect();
        let key: KernelKey = (text, bits);
        if let Some(known) = context.kernels.get(&key) {
            return Ok(known);
        }
        let module = source.parsed(&key.0)?;
        let entry = module.entry_points.first();
        let literal = entry.filter(|e| e.workgroup_size_overrides.is_none());
        let workgroup = literal.map(|e| e.workgroup_size);
        let bindings = source.bindings(&module);
        let program = Program {
            name: source.name,
            layout: layout(&context.device, source.name, &bindings),
            // Already parsed, to read the bindings. But a browser takes text, and naga writes arrays whose
            // length is an override without their element type.
            source: match BROWSER {
                true => wgpu::ShaderSource::Wgsl(Cow::Owned(key.0.clone())),
                false => wgpu::ShaderSource::Naga(Cow::Owned(module)),
            },
            constants: constants.to_vec(),
            pipeline: OnceLock::new(),
        };
        let kernel = Self { bindings, workgroup, program: Arc::new(program) };
        context.kernels.insert(key, &kernel);
        Ok(kernel)
    }

    /// Returns the number of invocations per workgroup along each axis.
    ///
    /// Panics if the workgroup size depends on the kernel's constants, in which case the caller has chosen
    /// it.
    pub fn workgroup(&self) -> [u32; 3] {
        self.workgroup.unwrap_or_else(|| panic!("{}.wgsl leaves its workgroup open", self.program.name))
    }

    /// Returns the number of workgroups that cover this many invocations along each axis.
    pub fn groups(&self, invocations: [usize; 3]) -> [u32; 3] {
        let group = self.workgroup();
        let count = |axis: usize| invocations[axis].div_ceil(group[axis] as usize);
        // A count that does not fit exceeds the limit of any device, and the schedule rejects it.
        [0, 1, 2].map(|axis| u32::try_from(count(axis)).unwrap_or(u32::MAX))
    }

    /// Returns the workgroups that cover `count` elements of each of `batch` items, in rows short enough for
    /// every device. The kernel numbers them along x, then y.
    pub fn spread(&self, count: usize, batch: usize) -> [u32; 3] {
        let [all, _, items] = self.groups([count, 1, batch]);
        Self::spread_groups(all, items)
    }

    /// As [`Kernel::spread`], for this many workgroups of each item.
    pub fn spread_groups(groups: u32, items: u32) -> [u32; 3] {
        let across = groups.clamp(1, WORKGROUPS);
        [across, groups.div_ceil(across), items]
    }
}

impl Program {
    /// Returns what was parsed, `None` in a browser, which gets the text.
    pub fn module(&self) -> Option<&naga::Module> {
        match &self.source {
            wgpu::ShaderSource::Naga(module) => Some(module),
            _ => None,
        }
    }

    /// Returns the pipeline, compiling it on first use. Fails if it does not compile.
    pub fn pipeline(&self, context: &Context) -> Result<&wgpu::ComputePipeline> {
        // Checked on the thread that compiles it: other threads do not see its errors.
        let compiled = || match context.checked(|| Ok(self.compile(context))) {
            Ok(pipeline) => Ok(pipeline),
            Err(Error::Device(why) | Error::Lost(why)) => Err(why),
            Err(other) => Err(other.to_string()),
        };
        let of = |why: &String| {
            if context.is_lost() { Error::Lost(why.clone()) } else { Error::Device(why.clone()) }
        };
        self.pipeline.get_or_init(compiled).as_ref().map_err(of)
    }

    fn compile(&self, context: &Context) -> wgpu::ComputePipeline {
        let device = &context.device;
        let label = Some(self.name);
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &[Some(&self.layout)],
            immediate_size: 0,
        });
        let module = trusted_module(device, self.name, self.source.clone());
        device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label,
            layout: Some(&layout),
            module: &module,
            entry_point: Some(self.name),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &self.constants,
                // Kernels write workgroup memory before they read it, or discard what they read (the rim in
                // `gradient`).
                zero_initialize_workgroup_memory: false,
            },
            cache: context.pipeline_cache(),
        })
    }
}

/// Creates the layout of a bind group with these bindings.
fn layout(device: &wgpu::Device, name: &'static str, bindings: &[Binding]) -> wgpu::BindGroupLayout {
    let entry = |(i, b): (usize, &Binding)| wgpu::BindGroupLayoutEntry {
        binding: i as u32,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: b.ty,
        count: None,
    };
    let entries: Vec<_> = bindings.iter().enumerate().map(entry).collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(name), entries: &entries })
}

/// Creates a shader module without naga's index clamps and loop counters, which slow the inner loops down by
/// up to a factor of ten.
#[allow(unsafe_code, reason = "one of three exceptions; see SAFETY")]
fn trusted_module(
    device: &wgpu::Device,
    name: &str,
    source: wgpu::ShaderSource<'static>,
) -> wgpu::ShaderModule {
    let descriptor = wgpu::ShaderModuleDescriptor { label: Some(name), source };
    // SAFETY: the module was parsed from a file of `shaders/`, compiled into this program: `Kernel` is
    // private to the crate, and callers cannot supply their own. Every loop there counts to a finite bound.
    // Computed indices are bounded by the sizes in the parameters, which the host side of each kernel
    // (`crate::kernels`) asserts against the shapes of the tensors it binds; where a whole buffer is bound
    // for a view, `Tensor::view` has asserted that the view is within it. Indices that are data are bounded
    // by the kernels themselves (particles in buckets, handle slots, the slots of drawn cloths in their pool
    // and the newest pair of L-BFGS) or by what wrote them: pairs of parts hold particles that `layer_find` has found on the
    // grid, and the cells of an embedded mesh are those of its grid (`cloth::Embedding`).
    unsafe { device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked()) }
}
