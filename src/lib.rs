//! Cloth simulation on the GPU with FNOpt (Chen, Tran and Parashar, WACV 2026), a Fourier neural operator
//! trained, from physics alone, to be an *optimizer*.
//!
//! Each frame minimises the backward-Euler energy of the cloth in about ten iterations, for arbitrary handles
//! and motions. The shipped weights were trained on grids from 24x40 to 128x128; they run on other grids,
//! too.
//!
//! ```
//! use fnopt::network::Weights;
//! use fnopt::scene::Scene;
//! use fnopt::sim::{Device, Optimizer, Simulator};
//!
//! let setup = Scene::default().setup()?; // a sheet hanging from two corners, grid units inside
//! let optimizer = Optimizer::learned(Weights::shipped());
//! let mut simulator = Simulator::new(&Device::Cpu, &setup.model, &optimizer, 10)?;
//! simulator.set_state(&setup.start.cast());
//! for frame in 1..4 {
//!     let frame = simulator.step(&setup.control(frame))?;
//!     println!("{:?} m", setup.vertices_m(&frame.state.x)[0]);
//! }
//! # Ok::<(), fnopt::Error>(())
//! ```
//!
//! # Data flow
//!
//! ```text
//! scene::Scene (SI units) -> scene::Setup: sim::Model (grid, material, air, handles) + sim::State (x, v), grid units
//! sim::Control (this frame's handles, wind, external accelerations) -> sim::Solver or cpu::Solver -> the next State
//! sim::Simulator: submits, reads back -> io::Trajectory, render::strip; or sim::Vertices, a vertex buffer in the caller's pass
//! ```
//!
//! The stages exist twice, with the same meaning. [`cpu`] implements them in plain Rust, in single or double
//! precision; the double-precision version defines what is correct. [`kernels`] and `shaders/` implement them
//! in WGSL on top of [`gpu`], the only module that creates wgpu objects. [`sim::Solver`] records a frame into
//! the caller's command encoder, without submitting, polling or mapping anything. [`sim::Simulator`] is the
//! convenience layer over both devices.
//!
//! # One frame
//!
//! [`sim::Simulator::step`] sets the control and computes one frame. On a GPU it submits the schedule that
//! [`sim::Solver::new`] built; on the CPU, [`cpu::Solver::step`] runs the same stages ([`cpu::cloth`],
//! [`cpu::operator`], [`cpu::optim`]):
//!
//! 1. [`kernels::cloth::Predict`] sets a = 0, which moves the particles by their velocity and the handles to
//!    their targets. [`kernels::cloth::ExternalForce`] sums gravity, the control's accelerations and the
//!    forces of the air.
//! 2. N times (paper section 3.3): if the layers of the cloth are to be kept apart,
//!    [`kernels::cloth::Repulsion`] adds the repulsion between nearby particles to the external acceleration.
//!    [`kernels::cloth::Gradient`] computes dL/da and its norm. [`network::Forward`] runs the network
//!    (section 4): the normalised fields ([`kernels::optim::Features`]), the lifting, four Fourier blocks
//!    (truncated transform, spectral product, inverse), the field head, and the scalar head with the
//!    persistent scale. [`kernels::optim::Update`] computes the step and adds it to a. A classical optimizer
//!    ([`sim::Optimizer`]) replaces everything after the gradient.
//! 3. [`kernels::cloth::Energy`] computes the statistics, with the repulsion evaluated once more.
//!    [`kernels::cloth::Integrate`] then updates the state: v += a, x += v.
//!
//! A training step ([`train::DeviceLoss`], [`cpu::train::Loss`]) is one such iteration, the energy at the new
//! a, and the backward pass through [`kernels::optim::UpdateAdj`] and [`network::Backward`].
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`scene`] | scene files, motions, materials, conversion to grid units |
//! | [`sim`] | model, state, control, optimizers, solver, simulator |
//! | [`network`] | sizes, weights, checkpoints, the forward and backward passes as dispatches |
//! | [`gpu`] | context, tensors, kernels, schedules, readback; knows nothing of cloth |
//! | [`kernels`] | the host side of each file in `shaders/`, in the same tree |
//! | [`cpu`] | the same stages without a GPU, and the converged minimum of a frame |
//! | [`eval`] | comparison with recorded sequences, suites, material fitting |
//! | [`io`], [`render`] | trajectory and mesh files; images |
//! | [`train`] | pools of cloths, the run loop and its files; built on the modules above |
//! | [`verify`] | checks of every stage against golden files |
//!
//! Lengths, times and masses are in SI units in scenes and files, and in *grid units* everywhere else: the
//! rest length of an edge, the time of a frame and the mass of a cell are 1. The z axis points up, and
//! particle (i, j) has number `i W + j`. State arrays are channel-first, `[B, 3, H, W]`.

pub mod cpu;
mod error;
pub mod eval;
pub mod gpu;
pub mod io;
pub mod kernels;
mod memory;
pub mod network;
pub mod render;
pub mod scene;
pub mod sim;
mod statistics;
pub mod train;
pub mod verify;

pub use error::{Error, Result};
pub use wgpu;
