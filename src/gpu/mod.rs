//! The GPU runtime, and the only module that makes wgpu's objects. It knows no cloth.
//!
//! [`Context`] wraps the caller's device and queue (or makes its own), [`Tensor`] is a typed storage buffer, [`Source`] is
//! a kernel's WGSL, unrolled as an adapter likes it, `Kernel` is its entry point, compiled when it is first used and shared by
//! all solvers of a device, [`Schedule`] is a list of
//! dispatches with everything bound, [`Readback`] brings results to the host without stalling the queue, [`Profile`] measures
//! dispatches where the adapter has timestamps. Compiled pipelines outlast the process where the adapter has a cache for them
//! ([`Context::with_stored_pipelines`]).

mod cache;
mod context;
mod kernel;
mod order;
mod profile;
mod readback;
mod schedule;
mod storage;
mod template;
mod tensor;

pub(crate) use cache::CACHE_FOLDER;
pub use context::{AdapterChoice, AdapterKind, AdapterSummary, Context, adapters};
pub(crate) use context::{WORKGROUP_INVOCATIONS, WORKGROUPS};
pub use kernel::Binding;
pub(crate) use kernel::Kernel;
pub use order::Order;
pub use profile::Profile;
pub use readback::Readback;
pub use schedule::Schedule;
pub use storage::Storage;
pub use template::{Sharing, Source, Unroll};
pub use tensor::Tensor;
