//! Cloth simulation on the GPU with FNOpt (Chen, Tran and Parashar, WACV 2026), a Fourier neural operator
//! trained, from physics alone, to be an *optimizer*.
//!
//! Each frame minimises the backward-Euler energy of the cloth in ten to twenty iterations, for arbitrary
//! handles and motions. The shipped weights were trained on grids from 24x40 to 128x128; they run on other grids,
//! too.
//!
//! ```
//! use fnopt::{Optimizer, Scene, Simulation};
//!
//! let scene = Scene::default(); // a sheet of a square metre that hangs from two corners, which move
//! let mut simulation = Simulation::new(&scene, &Optimizer::spectral())?;
//! for _ in 1..4 {
//!     let frame = simulation.step()?;
//!     println!("frame {}: mean stretch {:.2} %", frame.index, 100.0 * frame.stats[0].stretch_mean);
//! }
//! println!("{:?} m", simulation.positions()[0]);
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! With the feature `weights`, `Optimizer::learned(Weights::shipped())` adds the network. Scenes come from files ([`Scene::load`]), by name
//! ([`Scene::named`]) or from code ([`scene`]). [`Simulator`] is the layer below, in grid units and on a device of the caller's;
//! [`Solver`] records a frame into the encoder of a host that draws.
//!
//! # Data flow
//!
//! ```text
//! scene::Scene (SI units) -> scene::Setup: cloth::Model (grid, material, air, handles) + cloth::State (x, v), grid units
//! cloth::Control (this frame's handles, wind, external accelerations) -> sim::Solver or cpu::Solver -> the next State
//! Simulator: submits, reads back -> io::Recording, io::write, render::strip; or sim::Vertices, a vertex buffer in the caller's pass
//! Simulation: all of these for scenes that it owns, in SI units again; Python and C see no more than that
//! ```
//!
//! The stages exist twice, with the same meaning. [`cpu`] implements them in plain Rust, in single or double
//! precision; the double-precision version defines what is correct. What its vectorised sums over a cloth add up is
//! defined once more, plainly, element by element ([`cloth::terms`]). [`kernels`] and `shaders/` implement them
//! in WGSL on top of [`gpu`], the only module that creates wgpu objects but for what the viewer draws. [`sim::Solver`] records a frame into
//! the caller's command encoder, without submitting, polling or mapping anything. [`Simulator`] is the
//! convenience layer over both devices.
//!
//! # One frame
//!
//! [`Simulator::step`] sets the control and computes one frame. On a GPU it submits the schedule that
//! [`sim::Solver::new`] built; on the CPU, [`cpu::Solver::step`] runs the same stages ([`cpu::cloth`],
//! [`cpu::operator`], [`cpu::optim`]):
//!
//! [`kernels::cloth::Objective`] holds what the energy of a frame depends on and appends the dispatches that evaluate
//! it; [`cpu::Objective`] does the same on the CPU. The terms of the energy are in `shaders/terms`.
//!
//! 1. [`kernels::cloth::Predict`] prepares a = 0, which moves the particles by their velocity and the handles to
//!    their targets. [`kernels::cloth::ExternalForce`] sums gravity, the control's accelerations and the
//!    forces of the air. If there are bodies, [`kernels::cloth::ContactFind`] finds for each particle the planes that
//!    stand for them in this frame. A cloth that touches itself has planes between its own parts, too:
//!    [`kernels::cloth::Layers`] finds the pairs of parts that come near each other.
//! 2. N times (paper section 3.3): if the layers of the cloth are to be kept apart,
//!    [`kernels::cloth::Repulsion`] adds the repulsion between nearby particles to the external acceleration, and
//!    [`kernels::cloth::Contact`] the forces of bodies, and [`kernels::cloth::LayerForce`] those between layers that touch.
//!    [`kernels::cloth::Gradient`] computes dL/da and its norm. [`network::Forward`] runs the network
//!    (section 4): the normalised fields ([`kernels::optim::Features`]), the lifting, four Fourier blocks
//!    (truncated transform, spectral product, inverse), the field head, and the scalar head with the
//!    persistent scale. [`kernels::optim::Update`] computes its step. With `fnopt` that is one of four directions, whose scale
//!    begins with the size of the step before ([`kernels::operator::LastStep`]);
//!    the others are the gradient under the spectral inverse of the Hessian at rest, the step across the sheet's surface with what it asks
//!    for along it ([`kernels::optim::AnswerRows`], [`kernels::optim::SheetSteps`]), and the last step. [`kernels::cloth::Curvature`] sums the energy, its slopes and its second
//!    derivatives along them, and [`kernels::optim::SubspaceStep`] adds the combination that minimises this model to
//!    a. If the step before raised the energy, it shortens that one instead.
//!    [`kernels::cloth::ContactConfine`] keeps the step out of the bodies. With `fnopt-paper` the network's step is
//!    taken as it is. Other optimizers ([`sim::Optimizer`]) replace what follows the gradient.
//! 3. Layers that are still too near each other are parted ([`kernels::cloth::LayerPart`]), after a search for those that
//!    particles have met which left their way. [`kernels::cloth::Energy`] computes the statistics, with the repulsion evaluated once more.
//!    [`kernels::cloth::Integrate`] then updates the state: v += a, x += v. With bodies,
//!    [`kernels::cloth::ContactReport`] says what they did, and [`kernels::cloth::ContactEnd`] stops particles that stick.
//!
//! A frame in a subspace ([`kernels::optim::Subspace`]) starts near the accelerations of the two frames before
//! ([`kernels::optim::Extrapolate`]), and ends with a check that takes back a step that raised the energy. Its directions are turned into the
//! sheet's own axes ([`kernels::cloth::SheetAxes`]), which are shorter where contacts hold it ([`kernels::cloth::ContactAxes`],
//! [`kernels::cloth::LayerAxes`]).
//!
//! A training step ([`train::DeviceLoss`], [`cpu::train::Loss`]) is one such iteration, the energy at the new
//! a, and the backward pass through [`kernels::optim::UpdateAdj`] and [`network::Backward`].
//!
//! # Choices
//!
//! - One schedule serves a single cloth and large batches. How its kernels divide the work depends on grid, batch
//!   and adapter ([`network::Plan`], [`gpu::Tuning`]); [`gpu::Context::with_tuning`] overrides it.
//! - The CPU path multiplies matrices with kernels of its own: its products have at most 256 terms, begin with a
//!   bias and end in an activation, and spend longer in the calls of a library than in their sums.
//! - All kept modes are multiplied, although those of the first column are conjugates of each other: using that
//!   would save less than 1 % of a frame.
//! - In a browser nothing can wait for the device. A program for wasm32 opens it with
//!   [`gpu::Context::headless_async`] or its own code, records [`sim::Solver`]s and reads back with
//!   [`gpu::Readback::try_next`] (`examples/browser`). [`Simulator`], [`train`] and the files of [`io`] are
//!   native.
//!
//! # Modules
//!
//! Each uses only those above it.
//!
//! | module | contents |
//! |---|---|
//! | [`cloth`] | grid, material, state and control of cloths, in grid units; the terms of the energy |
//! | [`io`], [`render`] | trajectory and mesh files; images |
//! | [`settings`] | settings of the methods, for both devices |
//! | [`gpu`] | context, tensors, kernels, schedules, readback; knows nothing of cloth |
//! | [`kernels`] | the host side of each file in `shaders/`, in the same tree |
//! | [`network`] | sizes, weights, checkpoints, the forward and backward passes as dispatches |
//! | [`sim`] | optimizers, and the solver on a device |
//! | [`device`] | the choice of a device, opened with what is stored for it |
//! | [`cpu`] | the same stages without a GPU, and the converged minimum of a frame and of a cloth at rest |
//! | [`scene`] | scene files, motions, materials, conversion to grid units, the settled start |
//! | [`Simulator`] | frames on any device, read back |
//! | [`Simulation`] | scenes on any device, in SI units |
//! | [`eval`] | comparison with recorded sequences, suites, material fitting |
//! | [`train`] | pools of cloths, the run loop and its files |
//! | [`verify`] | checks of every stage against golden files |
//! | `view` | a window in which a scene runs or a trajectory is played back |
//! | `bindings` | what the interfaces to other languages share: names of solvers and devices |
//! | `python`, `capi` | the Python package (`docs/python.md`) and the C interface (`docs/c.md`) |
//!
//! [`eval`], [`train`] and [`verify`] belong to the feature `lab`, [`render`] to the feature `render`; `weights` embeds the shipped
//! weights. The command `fnopt` (`cli`) has all of them. `view`, `python` and `capi` belong to the features of their names.
//!
//! # Units, shapes and errors
//!
//! Bad input is an [`Error`]. A control whose length does not match the model is an error of
//! [`Simulator::step`] ([`cloth::Control::check`]); any other array of the wrong length is a panic, as
//! everywhere in [`sim::Solver`] and [`cpu::Solver`].
//!
//! Lengths, times and masses are in SI units in scenes and files, and in *grid units* everywhere else: the
//! rest length of an edge, the time of a frame and the mass of a cell are 1. The z axis points up, and
//! particle (i, j) has number `i W + j`. State arrays are channel-first, `[B, 3, H, W]`.

// Some parts serve evaluation and training alone.
#![cfg_attr(not(feature = "lab"), allow(dead_code, unused_imports, rustdoc::broken_intra_doc_links))]

#[cfg(any(feature = "python", feature = "capi"))]
mod bindings;
#[cfg(feature = "capi")]
pub mod capi;
pub mod cloth;
pub mod cpu;
pub mod device;
mod error;
#[cfg(feature = "lab")]
pub mod eval;
pub mod gpu;
pub mod io;
pub mod kernels;
mod memory;
pub mod network;
#[cfg(feature = "python")]
mod python;
#[cfg(feature = "render")]
pub mod render;
pub mod scene;
pub mod settings;
pub mod sim;
mod simulation;
mod simulator;
mod statistics;
#[cfg(feature = "lab")]
pub mod train;
#[cfg(feature = "lab")]
pub mod verify;
#[cfg(feature = "view")]
pub mod view;

pub use device::{Device, DeviceChoice, DeviceKind};
pub use error::{Error, Result};
pub use network::Weights;
pub use scene::Scene;
pub use sim::{Optimizer, Solver, Vertices};
pub use simulation::{Prescribed, Simulation, SimulationOptions, Snapshot};
pub use simulator::{Frame, Simulator};
// Crates whose types are part of this interface.
pub use {bytemuck, glam, ndarray, serde_json, wgpu};

/// The code of the manual compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
#[doc = include_str!("../docs/embedding.md")]
struct Manual;

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    /// Returns the modules of the table above, those of a row together.
    fn rows() -> Vec<Vec<String>> {
        let table = include_str!("lib.rs").lines().skip_while(|line| *line != "//! | module | contents |");
        let rows = table.skip(2).map_while(|line| line.strip_prefix("//! | ")).map(|line| {
            let (modules, _) = line.split_once(" | ").expect("a row has two cells");
            modules.split(", ").map(|name| name.trim_matches(['[', ']', '`']).to_lowercase()).collect()
        });
        rows.collect()
    }

    fn files(path: &Path) -> Vec<PathBuf> {
        if path.is_dir() {
            let entries = std::fs::read_dir(path).expect("a folder of src");
            return entries.flat_map(|entry| files(&entry.expect("an entry").path())).collect();
        }
        vec![path.to_owned()]
    }

    /// Returns the modules of this crate that a file names outside its comments.
    fn used(text: &str) -> Vec<String> {
        let code = text.lines().map(|line| line.split("//").next().unwrap_or_default());
        let code: String = code.collect::<Vec<_>>().join(" ");
        let mut names = Vec::new();
        for path in code.split("crate::").skip(1) {
            // A name, or those directly within the braces of a group.
            let mut depth = 0;
            for (at, c) in path.char_indices() {
                let begins = match c {
                    '{' => depth == 0,
                    ',' => depth == 1,
                    _ => at == 0,
                };
                depth += i32::from(c == '{') - i32::from(c == '}');
                let from = path[at..].trim_start_matches(['{', ',', ' ']);
                if begins && depth <= 1 {
                    names.push(from.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default());
                }
                if depth == 0 {
                    break;
                }
            }
        }
        // Those of the crate's root stand for the module that they come from.
        let of_root = |name| if name == "Frame" { "simulator" } else { name };
        // A group may end with a comma.
        names.into_iter().filter(|name| !name.is_empty()).map(|name| of_root(name).to_lowercase()).collect()
    }

    #[test]
    fn names_are_found_in_every_form_of_use() {
        let text = "use crate::{io::{a, b},\n    train, // crate::no\n};\n// crate::no\nlet x = crate::sim::f(crate::gpu);";
        assert_eq!(used(text), ["io", "train", "sim", "gpu"]);
        assert_eq!(used("use crate::Device; use crate::cloth::{Grid, Model};"), ["device", "cloth"]);
    }

    #[test]
    fn modules_use_only_those_above_them() {
        let (rows, src) = (rows(), Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
        let place = |module: &str| rows.iter().position(|row| row.iter().any(|name| name == module));
        for (own, module) in rows.iter().enumerate().flat_map(|(k, row)| row.iter().map(move |m| (k, m))) {
            let folder = src.join(module);
            let path = if folder.is_dir() { folder } else { folder.with_extension("rs") };
            for file in files(&path) {
                let text = std::fs::read_to_string(&file).expect("a source file");
                for name in used(&text).iter().filter(|name| *name != module) {
                    let above = place(name).is_none_or(|place| place <= own);
                    assert!(above, "{} uses {name}, which is below {module} in the table", file.display());
                }
            }
        }
        assert!(rows.len() > 10 && place("simulator").is_some(), "{rows:?}");
    }
}
