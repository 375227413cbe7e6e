//! `fnopt` simulates cloth on the GPU with FNOpt (Chen, Tran and Parashar, WACV 2026): a Fourier neural operator that was
//! trained, from physics alone, to be an *optimizer*. Each frame it minimises the backward-Euler energy of the cloth in
//! about ten iterations, with any handles and motions. The weights that ship were trained on grids from 24x40 to 128x128; others
//! run, too.
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
//! # What flows through
//!
//! ```text
//! scene::Scene (SI units) -> scene::Setup: sim::Model (grid, material, air, handles) + sim::State (x, v), grid units
//! sim::Control (this frame's handles, wind, external accelerations) -> sim::Solver or cpu::Solver -> the next State
//! sim::Simulator: submits, reads back -> io::Trajectory, render::strip; or the caller's own use of the position buffer
//! ```
//!
//! There are two devices and one meaning. [`cpu`] holds every stage in plain Rust, in single or double precision; in
//! double precision it defines what is correct. [`kernels`] and `shaders/` hold the same stages as WGSL on [`gpu`], the only
//! module that makes wgpu's objects. [`sim::Solver`] records a frame into a command encoder that the caller owns, which submits,
//! polls and maps nothing; [`sim::Simulator`] is the convenience on top.
//!
//! # One frame
//!
//! [`sim::Simulator::step`] sets the control and, on a GPU, records the schedule that [`sim::Solver::new`] built; without one
//! [`cpu::Solver::step`] runs the same stages ([`cpu::cloth`], [`cpu::operator`], [`cpu::optim`]):
//!
//! 1. [`kernels::cloth::Predict`]: a = 0 moves the particles by their velocity, the handles to their targets;
//!    [`kernels::cloth::ExternalForce`]: gravity, the control's accelerations and the air's drag.
//! 2. N times (paper section 3.3): where the cloth's layers are to be kept apart, [`kernels::cloth::Repulsion`] adds to the
//!    external acceleration what near particles push each other by; [`kernels::cloth::Gradient`] gives dL/da and its norm;
//!    [`network::Forward`] runs the network (section 4): the normalised fields ([`kernels::optim::Features`]), lifting, four Fourier
//!    blocks of truncated transform, spectral product and inverse, the field head, and the scalar head with the persistent scale;
//!    [`kernels::optim::Update`] makes the step and adds it to a. The classical optimizers ([`sim::Optimizer`]) take the place of
//!    everything behind the gradient.
//! 3. [`kernels::cloth::Energy`] for the statistics, with the repulsion's once more, then [`kernels::cloth::Integrate`]: v + a,
//!    x + v.
//!
//! A training step ([`train::DeviceLoss`], [`cpu::train::Loss`]) is one such iteration, the energy where it led, and the way
//! back through [`kernels::optim::UpdateAdj`] and [`network::Backward`].
//!
//! # The rooms
//!
//! | module | what is there |
//! |---|---|
//! | [`scene`] | scene files, motions, materials, conversion into grid units |
//! | [`sim`] | model, state, control, solver, simulator |
//! | [`network`] | sizes, weights, checkpoints, the forward and the backward pass as dispatches |
//! | [`gpu`] | context, tensors, kernels, schedules, readback; knows no cloth |
//! | [`kernels`] | the host side of each file in `shaders/`, in the same tree |
//! | [`cpu`] | the same stages without a GPU, and the converged minimum of a frame |
//! | [`eval`] | comparisons with recorded trajectories, suites, fits of materials |
//! | [`io`], [`render`] | trajectories and meshes in files; pictures |
//! | [`train`] | pools of cloths, the run loop and its files; imports the above |
//! | [`verify`] | every stage against golden files |
//!
//! Lengths, times and masses are SI units in scenes and files and *grid units* inside: the rest length of an edge and a
//! frame are 1, the height axis is z, and particle (i, j) has number `i W + j`. Arrays are channel-first, `[B, 3, H, W]`.

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
