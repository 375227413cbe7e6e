//! A device and its queue: the caller's, or a headless one opened by this crate.

use super::cache::PipelineCache;
use super::kernel::Kernels;
use super::template::LANES;
use super::{Order, Sharing, Storage, Tuning};
use crate::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

/// Kind of adapter that a device runs on. The kernels' tile sizes depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AdapterKind {
    /// A GPU, whether discrete, integrated or virtual.
    Hardware,
    /// A driver that runs shaders on the host's processor, such as llvmpipe, lavapipe or WARP.
    Software,
}

/// Which adapter to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The best hardware adapter that can be opened, or a software one if there is none.
    #[default]
    Best,
    /// The adapter at this index in the list of [`adapters`]. If the list is shorter, the number is taken for
    /// part of a name, as in "RTX 4090", and selects the first adapter whose name contains it as a word.
    Index(usize),
    /// The first adapter whose name, driver or backend contains this text, ignoring case.
    Name(String),
}

impl AdapterChoice {
    /// Parses the command line's `NAME|INDEX`.
    pub fn parse(text: &str) -> Self {
        text.parse().map_or_else(|_| Self::Name(text.to_owned()), Self::Index)
    }
}

/// An adapter of this machine, and whether fnopt can run on it.
#[derive(Clone, Debug)]
pub struct AdapterSummary {
    /// Name, driver, backend and type, as reported by wgpu.
    pub info: wgpu::AdapterInfo,
    /// Optional features that the adapter supports.
    pub features: wgpu::Features,
    /// Limits of the adapter.
    pub limits: wgpu::Limits,
    /// Why fnopt cannot run on it, if it cannot.
    pub unusable: Option<String>,
}

impl AdapterSummary {
    fn new(adapter: &wgpu::Adapter) -> Self {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let unusable = missing_limit(&limits);
        Self { info, features: adapter.features(), limits, unusable }
    }

    /// Returns whether the adapter is hardware or software.
    pub fn kind(&self) -> AdapterKind {
        kind(&self.info)
    }

    /// Whether [`Context::hardware`] may choose it: a hardware adapter that fnopt can run on.
    pub fn is_usable_hardware(&self) -> bool {
        self.kind() == AdapterKind::Hardware && self.unusable.is_none()
    }
}

/// A wgpu device and queue, with what the kernels need to know about them.
///
/// Cheap to clone: wgpu's handles are reference-counted.
#[derive(Clone, Debug)]
pub struct Context {
    /// The device.
    pub device: wgpu::Device,
    /// Its queue.
    pub queue: wgpu::Queue,
    kind: AdapterKind,
    name: String,
    storage: Storage,
    order: Order,
    tuning: Option<Tuning>,
    pub(super) pipelines: Option<Arc<PipelineCache>>,
    pub(super) kernels: Kernels,
}

/// Whether the device is a browser's, which does not answer before the caller has returned to the browser.
pub(super) const BROWSER: bool = cfg!(target_arch = "wasm32");
/// Number of storage buffers that a kernel may bind.
const STORAGE_BUFFERS: u32 = 8;
/// Largest number of invocations per workgroup that every device supports.
pub(crate) const WORKGROUP_INVOCATIONS: u32 = 256;
/// Largest number of workgroups along an axis that every device supports.
pub(crate) const WORKGROUPS: u32 = 65535;

impl Context {
    /// Wraps the caller's device and queue. Fails if the device's limits are too small for the kernels.
    ///
    /// Request the adapter's own limits when creating the device: the kernels run with WebGPU's defaults
    /// (`wgpu::Limits::default()`), but these allow bindings of at most 128 MiB.
    /// [`Context::optional_features`] are used if the device has them.
    pub fn new(device: wgpu::Device, queue: wgpu::Queue) -> Result<Self> {
        let info = device.adapter_info();
        if let Some(missing) = missing_limit(&device.limits()) {
            return Err(Error::Device(format!("{}: {missing}", info.name)));
        }
        let (kind, name, storage) = (kind(&info), describe(&info), Storage::default());
        Ok(Self {
            device,
            queue,
            kind,
            name,
            storage,
            order: Order::default(),
            tuning: None,
            pipelines: None,
            kernels: Kernels::default(),
        })
    }

    /// Opens a device without a window.
    pub fn headless(choice: &AdapterChoice) -> Result<Self> {
        pollster::block_on(Self::headless_async(choice))
    }

    /// As [`Context::headless`], for callers that already run an executor, and for browsers.
    pub async fn headless_async(choice: &AdapterChoice) -> Result<Self> {
        first_opened(choose(all_adapters().await, choice)?, Self::open).await
    }

    /// Opens a device that can show pictures on a surface, and returns the adapter, too. An index counts all adapters of this
    /// machine, whatever they can show. Fails as [`Context::headless`] does, or if the adapter cannot show anything there.
    pub fn for_surface(
        instance: &wgpu::Instance,
        surface: &wgpu::Surface<'_>,
        choice: &AdapterChoice,
    ) -> Result<(Self, wgpu::Adapter)> {
        pollster::block_on(async {
            let mut found = choose(adapters_of(instance).await, choice)?;
            let name = describe(&found[0].get_info());
            found.retain(|adapter| adapter.is_surface_supported(surface));
            if found.is_empty() {
                return Err(Error::Device(format!("{name}: cannot draw into a window of this display")));
            }
            let open = async |adapter: wgpu::Adapter| Ok((Self::open(adapter.clone()).await?, adapter));
            first_opened(found, open).await
        })
    }

    /// Opens a device on the best hardware adapter that can be opened; `None` if no usable one exists.
    /// Several processes on one machine pass different values of `turn`, counted from 0, to be spread evenly
    /// over the adapters of the best kind.
    pub fn hardware(turn: usize) -> Result<Option<Self>> {
        pollster::block_on(async {
            let found = all_adapters().await;
            let usable = |a: &wgpu::Adapter| {
                let summary = AdapterSummary::new(a);
                summary.is_usable_hardware().then_some((summary.info.device_type, summary.info.backend))
            };
            let order = in_turn(&found.iter().map(usable).collect::<Vec<_>>(), turn);
            if order.is_empty() {
                return Ok(None);
            }
            first_opened(order.into_iter().map(|at| found[at].clone()), Self::open).await.map(Some)
        })
    }

    /// Returns the features beyond WebGPU's defaults that fnopt can use: timestamps
    /// ([`Profile`](super::Profile)), subgroups and 64-bit integers ([`Sharing::Broadcast`]), 16-bit floating
    /// point ([`Storage::F16`]) and a pipeline cache ([`Context::with_stored_pipelines`]). Request those that
    /// the adapter offers.
    pub fn optional_features() -> wgpu::Features {
        wgpu::Features::TIMESTAMP_QUERY
            | wgpu::Features::SUBGROUP
            | wgpu::Features::SHADER_F16
            | wgpu::Features::SHADER_INT64
            | wgpu::Features::PIPELINE_CACHE
    }

    async fn open(adapter: wgpu::Adapter) -> Result<Self> {
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("fnopt"),
            required_features: adapter.features() & Self::optional_features(),
            required_limits: adapter.limits(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..Default::default()
        };
        let (device, queue) = adapter
            .request_device(&descriptor)
            .await
            .map_err(|e| Error::Device(format!("{}: cannot open: {e}", adapter.get_info().name)))?;
        Self::new(device, queue)
    }

    /// Returns the same device, on which networks store their activations and weights as `storage`.
    ///
    /// Fails if the device does not support it ([`wgpu::Features::SHADER_F16`]).
    pub fn with_storage(&self, storage: Storage) -> Result<Self> {
        if storage == Storage::F16 && !self.device.features().contains(wgpu::Features::SHADER_F16) {
            return Err(Error::Device(format!(
                "{}: does not support 16-bit floating point (f16)",
                self.name
            )));
        }
        Ok(Self { storage, ..self.clone() })
    }

    /// Returns the same device, on which kernels number their invocations in this order.
    pub fn with_order(&self, order: Order) -> Self {
        Self { order, ..self.clone() }
    }

    /// Returns the order in which kernels number their invocations.
    pub fn order(&self) -> Order {
        self.order
    }

    /// Returns the format in which networks store their activations and weights.
    pub fn storage(&self) -> Storage {
        self.storage
    }

    /// Returns the same device, whose kernels are built with these tile sizes instead of the table's.
    ///
    /// Fails if they do not work on it ([`Tuning::check`]).
    pub fn with_tuning(&self, tuning: Tuning) -> Result<Self> {
        tuning.check(self)?;
        Ok(Self { tuning: Some(tuning), ..self.clone() })
    }

    /// Returns the tile sizes of kernels: those set by [`Context::with_tuning`], else those of
    /// [`Tuning::table`].
    pub fn tuning(&self) -> Tuning {
        self.tuning.unwrap_or_else(|| Tuning::table(self))
    }

    /// Returns whether the adapter is hardware or software.
    pub fn kind(&self) -> AdapterKind {
        self.kind
    }

    /// Returns the adapter's name, driver and backend in one line.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether dispatches can be timed on this device.
    pub fn has_timestamps(&self) -> bool {
        self.device.features().contains(wgpu::Features::TIMESTAMP_QUERY)
    }

    /// Returns how kernels should read operands that a whole subgroup shares.
    pub fn sharing(&self) -> Sharing {
        let info = self.device.adapter_info();
        let lanes = [info.subgroup_min_size, info.subgroup_max_size];
        sharing(self.kind, self.device.features(), lanes)
    }

    /// Returns the largest size of a binding \[bytes\]: a whole number of vec4s, representable in 32 bits.
    pub fn largest_binding(&self) -> u64 {
        let limits = self.device.limits();
        let most = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        most.min(u32::MAX.into()) & !15
    }

    /// Creates a buffer with these contents, to copy from. Fails if there is not enough memory, or if the
    /// device is lost.
    pub fn upload(&self, label: &'static str, contents: &[u8]) -> Result<wgpu::Buffer> {
        self.checked(|| {
            let buffer = self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                // Not even without contents may it be empty.
                size: (contents.len() as u64).max(1).next_multiple_of(wgpu::COPY_BUFFER_ALIGNMENT),
                usage: wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: true,
            });
            // If there is no memory to map, `checked` knows why.
            if let Ok(mut mapped) = buffer.get_mapped_range_mut(..) {
                mapped.slice(..contents.len()).copy_from_slice(contents);
                drop(mapped);
                buffer.unmap();
            }
            Ok(buffer)
        })
    }

    /// Runs `build` and returns whatever the device reports (invalid objects, kernels that its driver cannot
    /// compile, lack of memory) as an error, and the loss of the device as [`Error::Lost`]. In a browser,
    /// which reports later, the device's handler of uncaptured errors receives them.
    pub fn checked<T>(&self, build: impl FnOnce() -> Result<T>) -> Result<T> {
        if BROWSER {
            return build();
        }
        use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
        // Running out of memory or a failing driver also invalidates objects. Those scopes enclose the one
        // for validation, so that the cause takes precedence.
        let scopes = [OutOfMemory, Internal, Validation].map(|filter| self.device.push_error_scope(filter));
        let built = build();
        // All scopes are popped, innermost first. The error of the outermost one is reported.
        let reported = scopes.into_iter().rev().filter_map(|scope| pollster::block_on(scope.pop())).last();
        // Objects created on a lost device are invalid, which is reported only when they are used.
        match reported {
            _ if self.is_lost() => Err(self.lost("it was reset or removed")),
            Some(e) => Err(Error::Device(format!("{}: {e}", self.name))),
            None => built,
        }
    }

    /// Runs `act`, whose errors the device need not report: another call reports the same cause.
    pub(super) fn unreported<T>(&self, act: impl FnOnce() -> T) -> T {
        if BROWSER {
            return act();
        }
        use wgpu::ErrorFilter::{OutOfMemory, Validation};
        let scopes = [OutOfMemory, Validation].map(|filter| self.device.push_error_scope(filter));
        let result = act();
        scopes.into_iter().rev().for_each(|scope| drop(pollster::block_on(scope.pop())));
        result
    }

    /// Whether the device is lost: it was destroyed, its driver was reset, or it is no longer there. Natively
    /// only: a browser tells the callback of the device's owner.
    pub fn is_lost(&self) -> bool {
        // wgpu tells whoever registers a callback, which is up to the owner of the device. To others it shows
        // in that a buffer cannot be mapped.
        self.unreported(|| {
            let probe = self.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("probe"),
                size: wgpu::COPY_BUFFER_ALIGNMENT,
                usage: wgpu::BufferUsages::MAP_WRITE,
                mapped_at_creation: true,
            });
            probe.get_mapped_range(..).is_err()
        })
    }

    fn lost(&self, why: &str) -> Error {
        Error::Lost(format!("{}: {why}", self.name))
    }

    /// Submits the commands that `record` writes to a fresh encoder.
    pub fn submit(&self, record: impl FnOnce(&mut wgpu::CommandEncoder)) -> wgpu::SubmissionIndex {
        self.queue.submit([self.commands(record)])
    }

    /// Returns the commands that `record` writes to a fresh encoder, to be submitted later.
    pub(crate) fn commands(&self, record: impl FnOnce(&mut wgpu::CommandEncoder)) -> wgpu::CommandBuffer {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        record(&mut encoder);
        encoder.finish()
    }

    /// Waits until everything submitted so far has completed. Fails if the device is lost. Callbacks of the
    /// device's owner may run here, as in any call that waits for the device.
    pub fn wait(&self) -> Result<()> {
        self.poll(wgpu::PollType::wait_indefinitely())?;
        // There is nothing to wait for on a device that was destroyed.
        if self.is_lost() { Err(self.lost("it was reset or removed")) } else { Ok(()) }
    }

    /// Polls the device, waiting as specified by `until`. Fails if the device is lost.
    pub(super) fn poll(&self, until: wgpu::PollType) -> Result<()> {
        // wgpu panics if the device is gone, but the caller may have frames to save. (A program that aborts
        // on panics ends here.)
        match catch_unwind(AssertUnwindSafe(|| self.device.poll(until))) {
            Ok(Ok(_)) => Ok(()),
            Ok(Err(e)) => Err(self.lost(&e.to_string())),
            Err(_) if self.is_lost() => Err(self.lost("it went away during a wait")),
            // A callback of the device's owner.
            Err(panic) => resume_unwind(panic),
        }
    }
}

/// Advice for machines on which no adapter is found.
pub const WHERE_ADAPTERS_COME_FROM: &str = if cfg!(target_os = "linux") {
    "Debian's package mesa-vulkan-drivers provides a software one; in a container, NVIDIA_DRIVER_CAPABILITIES \
     must include graphics"
} else {
    "the GPU's driver provides them"
};

/// Returns the adapters of this machine, hardware first, in the order that [`AdapterChoice::Index`] refers
/// to.
pub fn adapters() -> Vec<AdapterSummary> {
    pollster::block_on(all_adapters()).iter().map(AdapterSummary::new).collect()
}

async fn all_adapters() -> Vec<wgpu::Adapter> {
    // Not OpenGL, in case the host's wgpu has it: its start is noisy on machines without a display.
    let descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    let backends = descriptor.backends & wgpu::Backends::PRIMARY;
    adapters_of(&wgpu::Instance::new(wgpu::InstanceDescriptor { backends, ..descriptor })).await
}

async fn adapters_of(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    let mut found = instance.enumerate_adapters(wgpu::Backends::PRIMARY).await;
    found.sort_by_key(|a| match a.get_info().device_type {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    });
    found
}

/// Returns the adapters to try, in this order: one, unless the choice is left to us.
fn choose(mut found: Vec<wgpu::Adapter>, choice: &AdapterChoice) -> Result<Vec<wgpu::Adapter>> {
    let names: Vec<String> = found.iter().map(|a| describe(&a.get_info())).collect();
    let (at, wanted) = match choice {
        AdapterChoice::Best => {
            found.retain(|a| missing_limit(&a.limits()).is_none());
            if !found.is_empty() {
                return Ok(found);
            }
            (None, "no usable adapter".to_owned())
        }
        AdapterChoice::Index(i) => {
            let own_names: Vec<String> = found.iter().map(|a| a.get_info().name).collect();
            let at = (*i < found.len()).then_some(*i).or_else(|| numbered(&own_names, *i));
            (at, format!("no adapter with number or name {i}"))
        }
        AdapterChoice::Name(name) => (named(&names, name), format!("no adapter named '{name}'")),
    };
    let Some(at) = at else {
        let there = if names.is_empty() {
            format!("none found ({WHERE_ADAPTERS_COME_FROM})")
        } else {
            format!("this machine has: {}", names.join("; "))
        };
        return Err(Error::Device(format!("{wanted}; {there}")));
    };
    Ok(vec![found.swap_remove(at)])
}

/// Opens the first of these adapters, at least one, that opens, and warns of those before it; if none does, returns the
/// error of the first. One GPU may be listed by several drivers, not all of which work.
async fn first_opened<A, T>(
    adapters: impl IntoIterator<Item = A>,
    open: impl AsyncFn(A) -> Result<T>,
) -> Result<T> {
    let mut failed = Vec::new();
    for adapter in adapters {
        match open(adapter).await {
            Ok(opened) => {
                failed.iter().for_each(|error| tracing::warn!("{error}"));
                return Ok(opened);
            }
            Err(error) => failed.push(error),
        }
    }
    Err(failed.swap_remove(0))
}

/// Returns the index of the first name that contains this text, ignoring case; `None` if the text is blank.
fn named(names: &[String], text: &str) -> Option<usize> {
    let text = text.trim().to_lowercase();
    names.iter().position(|name| !text.is_empty() && name.to_lowercase().contains(&text))
}

/// Returns the index of the first name that contains this number as a word. Part of another number does not
/// count, nor does anything in parentheses, such as a version.
fn numbered(names: &[String], number: usize) -> Option<usize> {
    let number = number.to_string();
    let has_word = |name: &String| {
        let outside = name.split('(').map(|part| part.rsplit(')').next().unwrap_or_default());
        outside.flat_map(|part| part.split([' ', '-', '/'])).any(|word| word == number)
    };
    names.iter().position(has_word)
}

/// Returns the indices of the usable entries in the order in which to try them: first the `turn`-th of the
/// same kind as the first, wrapping around, then the others.
fn in_turn<T: PartialEq>(kinds: &[Option<T>], turn: usize) -> Vec<usize> {
    let usable: Vec<usize> = (0..kinds.len()).filter(|&at| kinds[at].is_some()).collect();
    let is_best = |&at: &usize| kinds[at] == kinds[usable[0]];
    let (mut best, others): (Vec<_>, Vec<_>) = usable.iter().partition(|at| is_best(at));
    let alike = best.len().max(1);
    best.rotate_left(turn % alike);
    [best, others].concat()
}

fn kind(info: &wgpu::AdapterInfo) -> AdapterKind {
    match info.device_type {
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        _ => AdapterKind::Hardware,
    }
}

/// Chooses how operands are read. They are broadcast only on software adapters that load words of 64 bits and
/// whose subgroups are exactly as wide as the kernels assume: in a wider one the operands differ.
fn sharing(kind: AdapterKind, features: wgpu::Features, lanes: [u32; 2]) -> Sharing {
    let needed = wgpu::Features::SUBGROUP | wgpu::Features::SHADER_INT64;
    let fits = features.contains(needed) && lanes == [LANES as u32; 2];
    if fits && kind == AdapterKind::Software { Sharing::Broadcast } else { Sharing::Loads }
}

fn describe(info: &wgpu::AdapterInfo) -> String {
    let driver = [info.driver.as_str(), info.driver_info.as_str()].join(" ");
    // Browsers do not tell.
    let name = if info.name.is_empty() { "unnamed adapter" } else { &info.name };
    match driver.trim() {
        "" => format!("{name} [{}]", info.backend),
        driver => format!("{name} [{}, {driver}]", info.backend),
    }
}

fn missing_limit(limits: &wgpu::Limits) -> Option<String> {
    let needs = [
        ("storage buffers per stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("invocations per workgroup", limits.max_compute_invocations_per_workgroup, WORKGROUP_INVOCATIONS),
        ("workgroup size along x", limits.max_compute_workgroup_size_x, WORKGROUP_INVOCATIONS),
        ("bytes of workgroup memory", limits.max_compute_workgroup_storage_size, 16 << 10),
        ("workgroups per dimension", limits.max_compute_workgroups_per_dimension, WORKGROUPS),
    ];
    let short = needs.into_iter().find(|(_, has, need)| has < need);
    short.map(|(what, has, need)| format!("expected at least {need} {what}, found {has}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A subgroup of 16 lanes may span two rows of a workgroup, whose operands differ.
    #[test]
    fn operands_are_broadcast_in_subgroups_of_one_width_only() {
        let features = wgpu::Features::SUBGROUP | wgpu::Features::SHADER_INT64;
        let of = |lanes| sharing(AdapterKind::Software, features, lanes);
        assert_eq!(of([8, 8]), Sharing::Broadcast);
        for lanes in [[4, 4], [4, 8], [8, 16], [16, 16], [8, 128]] {
            assert_eq!(of(lanes), Sharing::Loads, "{lanes:?}");
        }
    }

    #[test]
    fn a_number_is_a_place_or_a_word_of_a_name() {
        let names = ["NVIDIA GeForce RTX 4090", "llvmpipe (LLVM 15.0.6, 256 bits)"].map(String::from);
        assert_eq!(numbered(&names, 4090), Some(0));
        assert_eq!([1, 2, 5, 15, 40, 256].map(|number| numbered(&names, number)), [None; 6]);
        assert_eq!(numbered(&["NVIDIA GeForce RTX 4090/PCIe/SSE2".into()], 4090), Some(0));
        assert_eq!(numbered(&["Intel(R) UHD Graphics 630 (CFL GT2)".into()], 630), Some(0));
        assert_eq!(
            ["4090", "LLVM 15", "", " "].map(|text| named(&names, text)),
            [Some(0), Some(1), None, None]
        );
    }

    /// Two discrete adapters with an unusable one between them, and an integrated one: the discrete ones
    /// alternate.
    #[test]
    fn processes_take_the_adapters_of_the_best_kind_in_turn() {
        let kinds = [Some("discrete"), None, Some("discrete"), Some("integrated")];
        let tried = [0, 1, 2, 3].map(|turn| in_turn(&kinds, turn));
        assert_eq!(tried, [[0, 2, 3], [2, 0, 3], [0, 2, 3], [2, 0, 3]]);
        assert_eq!(in_turn(&kinds[3..], 5), [0]);
        assert!(in_turn(&kinds[1..2], 0).is_empty());
    }

    #[test]
    fn an_adapter_that_does_not_open_gives_way_to_the_next() {
        let open = async |at: usize| if at < 2 { Err(Error::Device(format!("{at}"))) } else { Ok(at) };
        assert_eq!(pollster::block_on(first_opened([0, 1, 2, 3], open)).unwrap(), 2);
        let error = pollster::block_on(first_opened([0, 1], open)).unwrap_err();
        assert_eq!(error.to_string(), Error::Device("0".into()).to_string());
    }
}
