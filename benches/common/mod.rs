//! Code shared by the benches.

use criterion::Criterion;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context};
use std::time::Duration;

/// Returns a configuration of few samples and short measurements: a software adapter takes up to a second per
/// frame.
pub fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args()
}

/// Opens the best adapter, which may be a software one. Prints why if there is none.
pub fn adapter() -> Option<Context> {
    match Context::headless(&AdapterChoice::Best) {
        Ok(context) => Some(context),
        Err(error) => {
            eprintln!("skipping the GPU: {error}");
            None
        }
    }
}

/// Whether the adapter runs on the host's processor.
pub fn is_software(context: &Context) -> bool {
    context.kind() == AdapterKind::Software
}
