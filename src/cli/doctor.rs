//! `fnopt doctor`: what this machine can run.

use super::output::output;
use super::{Ending, load_weights, median};
use anyhow::Result;
use fnopt::cloth::Grid;
use fnopt::gpu::{AdapterChoice, AdapterSummary, Context, WHERE_ADAPTERS_COME_FROM, adapters};
use fnopt::io::parse_npy;
use fnopt::scene::Scene;
use fnopt::sim::Optimizer;
use fnopt::{Device, Error, Simulator};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

/// Arguments of `fnopt doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Largest accepted error of a coordinate against the vectors in double precision [m]. Single precision is
/// accurate to 1e-6 of the side.
const TOLERANCE_M: f64 = 2e-5;
/// Frames that are timed, after one untimed frame.
const FRAMES: usize = 5;
/// Particles along either side of the sheets that are timed.
const GRIDS: [usize; 2] = [32, 64];

#[derive(serde::Serialize)]
struct Report {
    device: String,
    /// Why it cannot run, if it cannot.
    problem: Option<String>,
    /// Largest error of the self-test [m].
    error_m: Option<f64>,
    passed: bool,
    /// Whether it computes wrong results, or is the CPU path and does not run.
    failed: bool,
    times: Vec<Timing>,
}

/// How long a frame of one cloth takes with the default number of iterations.
#[derive(Clone, Debug, serde::Serialize)]
struct Timing {
    solver: &'static str,
    iterations: usize,
    /// Particles along either side.
    grid: usize,
    ms_per_frame: f64,
}

/// Error of the self-test [m] and the timings.
type Measured = (f64, Vec<Timing>);

pub fn run(args: &Args) -> Result<Ending> {
    let found = adapters();
    // The same choice, and not only the best of the list: that one may not open.
    let opened = Context::hardware(0).ok().flatten().map(|context| context.device.adapter_info());
    let auto = match found.iter().position(|adapter| Some(&adapter.info) == opened.as_ref()) {
        Some(i) => format!("adapter {i}, {}", found[i].info.name),
        None => "the CPU path (no usable hardware adapter)".to_owned(),
    };
    let mut out = output();
    if !args.json {
        writeln!(out, "fnopt {}", env!("CARGO_PKG_VERSION"))?;
        if found.is_empty() {
            writeln!(out, "no adapters ({WHERE_ADAPTERS_COME_FROM})")?;
        }
        for (i, adapter) in found.iter().enumerate() {
            describe(&mut out, i, adapter)?;
        }
        writeln!(out, "--device auto takes {auto}")?;
    }
    let mut reports = vec![examine("cpu".to_owned(), || Ok(Device::Cpu))];
    for (i, adapter) in found.iter().enumerate() {
        let name = format!("adapter {i}, {}", adapter.info.name);
        reports.push(match &adapter.unusable {
            Some(problem) => Report::unusable(name, problem.clone()),
            None => examine(name, || Ok(Device::Gpu(Context::headless(&AdapterChoice::Index(i))?))),
        });
    }
    let fastest = fastest(&reports);
    if args.json {
        let listed: Vec<_> = found.iter().map(summary).collect();
        let recommended: Vec<_> = fastest
            .iter()
            .map(|(device, timing)| {
                let mut with_device = serde_json::to_value(timing)?;
                with_device["device"] = (*device).into();
                Ok(with_device)
            })
            .collect::<serde_json::Result<_>>()?;
        let all = serde_json::json!({
            "version": env!("CARGO_PKG_VERSION"), "adapters": listed, "auto": auto, "devices": reports,
            "recommended": recommended,
        });
        writeln!(out, "{all:#}")?;
    } else {
        for report in &reports {
            print(&mut out, report)?;
        }
        for (device, Timing { solver, grid, ms_per_frame, .. }) in &fastest {
            let frame = format!("{grid}x{grid} {ms_per_frame:.2} ms/frame");
            writeln!(out, "fastest for one cloth: {frame} with --solver {solver} on {device}")?;
        }
        if !fastest.is_empty() {
            writeln!(out, "where frames must be exact: --solver newton, on the CPU alone")?;
        }
    }
    Ok(if reports.iter().any(|r| r.failed) { Ending::CheckFailed } else { Ending::Done })
}

impl Report {
    fn unusable(device: String, problem: String) -> Self {
        Self {
            device,
            problem: Some(problem),
            error_m: None,
            passed: false,
            failed: false,
            times: Vec::new(),
        }
    }

    /// Builds the report from the outcome of the self-test (its error) and the timings. An adapter that
    /// cannot run fnopt is not a failure. One that computes wrong results is, and so is a CPU path that does
    /// not run.
    fn of(device: String, on_cpu: bool, outcome: fnopt::Result<Measured>) -> Self {
        match outcome {
            Ok((error, times)) => {
                let passed = error <= TOLERANCE_M;
                Self { device, problem: None, error_m: Some(error), passed, failed: !passed, times }
            }
            Err(e) => {
                let failed = on_cpu || matches!(e, Error::NonFinite { .. });
                Self { failed, ..Self::unusable(device, e.to_string()) }
            }
        }
    }
}

/// Runs the self-test and the timings.
fn examine(name: String, open: impl FnOnce() -> fnopt::Result<Device>) -> Report {
    let mut on_cpu = false;
    let run = || -> fnopt::Result<Measured> {
        let device = open()?;
        on_cpu = matches!(device, Device::Cpu);
        let weights = Arc::new(load_weights(None)?);
        // The network's step alone: a step that is checked against the energy would hide part of an error.
        let error = self_test(&device, &Optimizer::paper(weights.clone()))?;
        let mut times = Vec::new();
        for optimizer in [Optimizer::spectral(), Optimizer::learned(weights)] {
            for grid in GRIDS {
                times.push(time(&device, &optimizer, grid)?);
            }
        }
        Ok((error, times))
    };
    let outcome = run();
    Report::of(name, on_cpu, outcome)
}

/// The scene of the self-test. Wind from an odd direction moves all components of the gradient: the published rule
/// divides each by its norm, and would make a step of the roundings of one that vanishes.
const SCENE: &str = include_str!("../../assets/selftest/scene.json");
/// Vertices after its first frame with the shipped weights, computed in double precision \[m\], shape [1024, 3].
/// `tests/cpu/rollout.rs` keeps them up to date.
const VECTORS: &[u8] = include_bytes!("../../assets/selftest/first_frame.npy");

/// Returns the largest difference of a coordinate from the stored vectors after that frame [m].
fn self_test(device: &Device, optimizer: &Optimizer) -> fnopt::Result<f64> {
    let setup = Scene::parse(SCENE, "the self-test", Path::new(""))?.setup()?;
    let mut simulator = Simulator::new(device, &setup.model, optimizer, 10)?;
    simulator.set_state(&setup.start.cast());
    let frame = simulator.step(&setup.control(1))?;
    let (found, expected) = (setup.vertices_m(&frame.state.x), parse_npy("the self-test", VECTORS)?);
    let errors = found.iter().flatten().zip(&expected).map(|(f, e)| (f - e).abs());
    Ok(errors.fold(0.0, f64::max))
}

/// Returns the least time on any device that passed, with that device, for each size.
fn fastest(reports: &[Report]) -> Vec<(&str, &Timing)> {
    let passed = reports.iter().filter(|report| report.passed);
    let all: Vec<_> = passed.flat_map(|r| r.times.iter().map(|timing| (&*r.device, timing))).collect();
    let least = |grid| {
        let of_grid = all.iter().filter(|(_, timing)| timing.grid == grid);
        of_grid.min_by(|(_, a), (_, b)| a.ms_per_frame.total_cmp(&b.ms_per_frame)).copied()
    };
    GRIDS.into_iter().filter_map(least).collect()
}

fn time(device: &Device, optimizer: &Optimizer, grid: usize) -> fnopt::Result<Timing> {
    let mut scene = Scene::default();
    scene.regrid(Grid::new(grid, grid, "doctor")?)?;
    let setup = scene.setup()?;
    let iterations = optimizer.default_iterations();
    let mut simulator = Simulator::new(device, &setup.model, optimizer, iterations)?;
    simulator.set_state(&setup.start.cast());
    let mut times = Vec::new();
    simulator.rollout((1..=FRAMES + 1).map(|f| setup.control(f)), |frame| {
        if frame.index > 1 {
            times.push(frame.wall.as_secs_f64() * 1e3);
        }
        ControlFlow::Continue(())
    })?;
    Ok(Timing { solver: optimizer.name(), iterations, grid, ms_per_frame: median(&times) })
}

/// The features and limits that matter to fnopt.
fn facts(adapter: &AdapterSummary) -> [(&'static str, String); 7] {
    let has = |feature| if adapter.features.contains(feature) { "yes" } else { "no" }.to_owned();
    let limits = &adapter.limits;
    [
        ("timestamps", has(wgpu::Features::TIMESTAMP_QUERY)),
        ("f16", has(wgpu::Features::SHADER_F16)),
        ("subgroups", has(wgpu::Features::SUBGROUP)),
        ("cooperative matrices", has(wgpu::Features::EXPERIMENTAL_COOPERATIVE_MATRIX)),
        ("largest binding", format!("{} MiB", limits.max_storage_buffer_binding_size >> 20)),
        ("storage buffers", limits.max_storage_buffers_per_shader_stage.to_string()),
        ("workgroup memory", format!("{} KiB", limits.max_compute_workgroup_storage_size >> 10)),
    ]
}

fn describe(out: &mut impl Write, i: usize, adapter: &AdapterSummary) -> std::io::Result<()> {
    let info = &adapter.info;
    writeln!(out, "adapter {i}: {} [{}, {:?}]", info.name, info.backend, info.device_type)?;
    let driver = format!("{} {}", info.driver, info.driver_info);
    writeln!(out, "  {:22} {}", "driver", driver.trim())?;
    for (what, value) in facts(adapter) {
        writeln!(out, "  {what:22} {value}")?;
    }
    match &adapter.unusable {
        Some(problem) => writeln!(out, "  unusable: {problem}"),
        None => Ok(()),
    }
}

fn summary(adapter: &AdapterSummary) -> serde_json::Value {
    let info = &adapter.info;
    let facts: serde_json::Map<String, serde_json::Value> =
        facts(adapter).into_iter().map(|(k, v)| (k.to_owned(), v.into())).collect();
    serde_json::json!({
        "name": info.name, "backend": info.backend.to_string(), "type": format!("{:?}", info.device_type),
        "driver": format!("{} {}", info.driver, info.driver_info).trim(), "facts": facts, "unusable": adapter.unusable,
    })
}

fn print(out: &mut impl Write, report: &Report) -> std::io::Result<()> {
    if let Some(problem) = &report.problem {
        let verdict = if report.failed { "SELF-TEST FAILED" } else { "cannot run" };
        return writeln!(out, "{}: {verdict}: {problem}", report.device);
    }
    let verdict = if report.passed { "self-test passed" } else { "SELF-TEST FAILED" };
    write!(out, "{}: {verdict}", report.device)?;
    if let Some(error) = report.error_m {
        write!(out, " (error {error:.1e} m)")?;
    }
    writeln!(out)?;
    for Timing { solver, iterations, grid, ms_per_frame } in &report.times {
        let what = format!("{solver}, {iterations} iterations");
        writeln!(out, "  {what:22} {grid}x{grid} {ms_per_frame:.2} ms/frame")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn non_finite_results_and_a_failing_cpu_path_are_failures() {
        let failed = |on_cpu, outcome| Report::of("device".into(), on_cpu, outcome).failed;
        assert!(!failed(false, Ok((1e-6, Vec::new()))));
        assert!(failed(false, Ok((1e-3, Vec::new()))) && failed(false, Ok((f64::NAN, Vec::new()))));
        assert!(failed(false, Err(Error::NonFinite { frame: 1, cloth: 0 })));
        assert!(!failed(false, Err(Error::Device("limits are too small".into()))));
        assert!(failed(true, Err(Error::Device("anything".into()))));
    }

    #[test]
    fn the_fastest_of_the_devices_that_passed_is_recommended() {
        let report = |device: &str, error, [small, large]: [f64; 2]| {
            let timing =
                |(grid, ms_per_frame)| Timing { solver: "spectral", iterations: 20, grid, ms_per_frame };
            Report::of(device.into(), false, Ok((error, [(32, small), (64, large)].map(timing).to_vec())))
        };
        let reports =
            [report("cpu", 1e-6, [2.0, 9.0]), report("card", 1e-6, [3.0, 4.0]), report("odd", 1.0, [1.0; 2])];
        let found: Vec<_> =
            fastest(&reports).iter().map(|(device, of)| (*device, of.grid, of.ms_per_frame)).collect();
        assert_eq!(found, [("cpu", 32, 2.0), ("card", 64, 4.0)]);
        assert!(fastest(&[Report::unusable("card".into(), "too old".into())]).is_empty());
    }
}
