//! Helpers shared by the GPU tests: one device for all, tensors that reveal unwritten elements, comparisons.

use fnopt::cloth::Grid;
use fnopt::cpu;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context, Schedule, Sharing, Storage, Tensor, Tuning};
use fnopt::kernels::padded;
use std::sync::{Condvar, LazyLock, Mutex};

/// Grids of the parity tests: the smallest, one with odd sides, a tall one and a larger one.
pub const GRIDS: [Grid; 4] =
    [Grid { h: 8, w: 8 }, Grid { h: 31, w: 33 }, Grid { h: 48, w: 32 }, Grid { h: 100, w: 100 }];
/// Batch sizes of the parity tests.
pub const BATCHES: [usize; 2] = [1, 3];
/// The distance from 1 to the next f32: the largest relative error of a product and a sum, each rounded once.
pub const ROUNDING: f64 = f32::EPSILON as f64;

/// Returns every grid with every batch size.
pub fn cases() -> impl Iterator<Item = (Grid, usize)> {
    GRIDS.into_iter().flat_map(|grid| BATCHES.map(|batch| (grid, batch)))
}

/// Returns some of [`cases`]: `count` grids, which go round with `turn`, with every batch size. Kernels are compiled anew for each
/// pair of a tuning and a grid, so that tests of many tunings try each on some grids.
pub fn cases_in_turn(turn: usize, count: usize) -> impl Iterator<Item = (Grid, usize)> {
    let grids = (turn..turn + count).map(|place| GRIDS[place % GRIDS.len()]);
    grids.flat_map(|grid| BATCHES.map(|batch| (grid, batch)))
}

/// Returns the device of all tests. Compiling the kernels for each test would take most of the time.
pub fn context() -> &'static Context {
    static CONTEXT: LazyLock<Context> = LazyLock::new(|| {
        Context::headless(&AdapterChoice::Best).unwrap_or_else(|e| {
            panic!(
                "the GPU tests need an adapter; a software one will do (Debian and Ubuntu: apt-get install \
                 mesa-vulkan-drivers): {e}"
            )
        })
    });
    &CONTEXT
}

/// Opens a device on the same adapter that binds at most `bytes` bytes at once.
pub fn narrow(bytes: u64) -> Context {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let opened = pollster::block_on(async {
        let own = context().device.adapter_info();
        let adapters = instance.enumerate_adapters(wgpu::Backends::all()).await;
        let adapter = adapters.into_iter().find(|adapter| adapter.get_info() == own).unwrap();
        let required_limits = wgpu::Limits { max_storage_buffer_binding_size: bytes, ..adapter.limits() };
        adapter.request_device(&wgpu::DeviceDescriptor { required_limits, ..Default::default() }).await
    });
    let (device, queue) = opened.unwrap();
    Context::new(device, queue).unwrap()
}

/// Returns the device with networks stored in 16 bits, or `None`, with a message, if the adapter lacks f16.
pub fn half() -> Option<Context> {
    let half = context().with_storage(Storage::F16);
    assert!(half.is_ok() || context().kind() == AdapterKind::Hardware, "the software adapter supports f16");
    half.inspect_err(|e| eprintln!("skipped: {e}")).ok()
}

/// A test's turn on the device, which ends when it is dropped.
pub struct Turn(());

/// Turns that are left. A software driver compiles a kernel on one core and computes a dispatch on all, so two
/// tests at once keep the cores busy; more would only take more memory. With hardware all cores compile.
static TURNS: LazyLock<(Mutex<usize>, Condvar)> = LazyLock::new(|| {
    let at_once = match context().kind() {
        AdapterKind::Software => 2,
        AdapterKind::Hardware => std::thread::available_parallelism().map_or(2, usize::from),
    };
    (Mutex::new(at_once), Condvar::new())
});

/// Waits for a turn on the device.
pub fn device() -> Turn {
    // A failed test leaves nothing behind that another one could see.
    let left = TURNS.0.lock().unwrap_or_else(|e| e.into_inner());
    let mut left = TURNS.1.wait_while(left, |left| *left == 0).unwrap_or_else(|e| e.into_inner());
    *left -= 1;
    Turn(())
}

impl Drop for Turn {
    fn drop(&mut self) {
        *TURNS.0.lock().unwrap_or_else(|e| e.into_inner()) += 1;
        TURNS.1.notify_one();
    }
}

/// Returns the tunings of both kinds of adapter, then the other tile widths that the kernels allow.
pub fn tunings() -> [Tuning; 5] {
    let software = Tuning::of(AdapterKind::Software, context().sharing());
    let hardware = Tuning::of(AdapterKind::Hardware, Sharing::Loads);
    [
        software,
        hardware,
        Tuning { block_span: 2, block_lines: 3, ..hardware },
        Tuning {
            channels: 16,
            block_wide: 32,
            block_span: 2,
            block_deep: 4,
            rows_in_blocks: false,
            spectral_teams: 2,
            busy_groups: 25,
            ..software
        },
        Tuning {
            channels: 4,
            pointwise_group: 32,
            block_wide: 16,
            block_span: 4,
            block_deep: 2,
            staged: false,
            spectral_teams: 2,
            busy_groups: 60,
            ..hardware
        },
    ]
}

/// Returns the two tunings that differ in how a subgroup shares its operands.
pub fn sharings() -> [Tuning; 2] {
    let [software, hardware, ..] = tunings();
    [software, hardware]
}

/// Creates a tensor that holds `data`.
pub fn tensor(label: &'static str, shape: &[usize], data: &[f32]) -> Tensor {
    Tensor::from_slice(context(), label, shape, data).unwrap()
}

/// Creates a tensor of NaN: elements that a kernel does not write remain NaN.
pub fn poisoned(label: &'static str, shape: &[usize]) -> Tensor {
    tensor(label, shape, &vec![f32::NAN; shape.iter().product()])
}

/// Builds a schedule and runs it. Panics if the device reports an error.
pub fn run(build: impl FnOnce(&mut Schedule)) {
    let context = context();
    let ran = context.checked(|| {
        let mut schedule = Schedule::new(context);
        build(&mut schedule);
        context.submit(|encoder| schedule.record(encoder));
        context.wait()
    });
    ran.unwrap();
}

/// Reads back a tensor.
pub fn read(tensor: &Tensor) -> Vec<f32> {
    tensor.read(context()).unwrap()
}

/// Reads back a network tensor [.., H, W'] without the padding of its rows.
pub fn read_unpadded(tensor: &Tensor, grid: Grid) -> Vec<f32> {
    let rows = read(tensor);
    rows.chunks_exact(padded(grid.w)).flat_map(|row| &row[..grid.w]).copied().collect()
}

/// Pads rows of `grid` as in a network tensor, with `filler` in the padding.
pub fn pad(rows: &[f32], grid: Grid, filler: f32) -> Vec<f32> {
    let spare = padded(grid.w) - grid.w;
    rows.chunks_exact(grid.w)
        .flat_map(|row| row.iter().copied().chain(std::iter::repeat_n(filler, spare)))
        .collect()
}

/// Reorders samples [S, C, H, W] into a network tensor [S, H, C, W'], with `filler` in the padding.
pub fn by_rows(dense: &[f32], channels: usize, grid: Grid, filler: f32) -> Vec<f32> {
    let mut rows = Vec::with_capacity(dense.len());
    for sample in dense.chunks_exact(channels * grid.particles()) {
        for i in 0..grid.h {
            rows.extend(
                sample.chunks_exact(grid.particles()).flat_map(|plane| &plane[i * grid.w..][..grid.w]),
            );
        }
    }
    pad(&rows, grid, filler)
}

/// Reads back a network tensor [S, H, C, W'] as samples [S, C, H, W].
pub fn read_channels(tensor: &Tensor, grid: Grid) -> Vec<f32> {
    let (rows, channels) = (read_unpadded(tensor, grid), tensor.shape()[2]);
    let mut dense = Vec::with_capacity(rows.len());
    for sample in rows.chunks_exact(channels * grid.particles()) {
        for c in 0..channels {
            dense.extend(
                sample.chunks_exact(channels * grid.w).flat_map(|line| &line[c * grid.w..][..grid.w]),
            );
        }
    }
    dense
}

/// Returns random numbers in -1..1.
pub fn noise(len: usize, seed: u64) -> Vec<f32> {
    crate::noise::noise(len, seed).into_iter().map(|v| v as f32).collect()
}

/// Converts single precision to double.
pub fn widened(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

/// Converts double precision to single.
pub fn narrowed(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
}

/// Returns the largest magnitude.
pub fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |m: f64, v| m.max(v.abs()))
}

/// Checks the axes [B, 16, n] that a device has shortened where contacts hold particles, given what they were and the host's
/// objective at the same accelerations.
pub fn assert_shortened(what: &str, host: &cpu::Objective<f64>, (axes, found): (&[f32], &[f32]), atol: f64) {
    let mut wanted = widened(axes);
    let batch = host.model().batch();
    let of_cloth = wanted.len() / batch;
    for (b, axes) in wanted.chunks_exact_mut(of_cloth).enumerate() {
        host.shorten_axes(b, axes);
    }
    let changed =
        wanted.iter().zip(axes).filter(|(wanted, axis)| wanted.abs() < 0.99 * f64::from(axis.abs()));
    assert!(changed.count() > 0, "{what}: nothing is held");
    assert_close(&format!("axes of {what}"), found, &wanted, (atol, 0.0));
}

/// Asserts that `|found - expected| <= atol + rtol |expected|` for every element; NaN fails.
pub fn assert_close(what: &str, found: &[f32], expected: &[f64], (atol, rtol): (f64, f64)) {
    assert_eq!(found.len(), expected.len(), "{what}: number of elements");
    // The share of its tolerance that each element uses.
    let used =
        |(&f, &e): (&f32, &f64)| (f64::from(f) - e).abs() / (atol + rtol * e.abs()).max(f64::MIN_POSITIVE);
    let mut worst = (0, 0.0);
    for (i, pair) in found.iter().zip(expected).enumerate() {
        let used = used(pair);
        if used.is_nan() || used > worst.1 {
            worst = (i, if used.is_nan() { f64::INFINITY } else { used });
        }
    }
    let (at, used) = worst;
    // Shown with --nocapture: the basis for choosing tolerances.
    println!("{what}: {:.0} % of the tolerance {atol:.1e} + {rtol:.1e} |x|", 100.0 * used);
    if used > 1.0 {
        panic!("{what}: element {at} is {}, not {} ({used:.2} of the tolerance)", found[at], expected[at]);
    }
}
