//! The GPU runtime, and the only module that creates wgpu objects. It knows nothing about cloth.
//!
//! [`Context`] wraps the caller's device and queue (or opens its own). [`Tensor`] is an array in a storage
//! buffer or texture. `Source` is a kernel's WGSL, unrolled to suit an adapter. `Kernel` is its entry
//! point, compiled on first use and shared by all solvers of a context. [`Tuning`] holds the tile sizes that
//! suit an adapter. [`Schedule`] is a list of dispatches with everything bound. [`Readback`] brings results
//! to the host without stalling the queue. [`Profile`] times dispatches if the adapter has timestamps; [`Schedule::work`] counts what they do,
//! and a [`Card`] says how long that would take it.
//! Compiled pipelines outlast the process if the adapter has a pipeline cache
//! ([`Context::with_stored_pipelines`]).

mod cache;
mod card;
mod context;
mod kernel;
mod order;
mod profile;
mod readback;
mod schedule;
mod storage;
mod template;
mod tensor;
mod tuning;
mod wide;
mod work;

pub(crate) use cache::CACHE_FOLDER;
pub use card::{Bound, CARDS, Card};
pub use context::{AdapterChoice, AdapterKind, AdapterSummary, Context, WHERE_ADAPTERS_COME_FROM, adapters};
pub(crate) use context::{WORKGROUP_INVOCATIONS, WORKGROUPS};
pub(crate) use kernel::Kernel;
pub use order::Order;
pub use profile::Profile;
pub use readback::Readback;
pub use schedule::Schedule;
pub use storage::Storage;
pub use template::Sharing;
pub(crate) use template::{LANES, Source, Unroll};
pub use tensor::Tensor;
pub use tuning::Tuning;
pub use work::{Latencies, Work};
