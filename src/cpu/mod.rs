//! The CPU path: the stages of a frame and of a training step in plain Rust, generic over [`Real`], and the
//! converged minimum of a frame ([`Reference`]).
//!
//! In f64 it defines what is correct: every shader is tested against it. In f32, threaded and vectorised, it
//! runs where there is no GPU adapter.

pub mod cloth;
mod compiled;
mod elementary;
mod equilibrium;
mod factored_hessian;
pub mod fft;
mod matmul;
mod objective;
pub mod operator;
pub mod optim;
mod real;
mod reference;
mod solver;
pub mod train;

pub use equilibrium::{Equilibrium, equilibrium};
pub use factored_hessian::FactoredHessian;
pub use matmul::peak_rate;
pub use objective::Objective;
pub use real::Real;
pub(crate) use reference::free_fall;
pub use reference::{Minimum, Reference, Track};
pub use solver::Solver;
