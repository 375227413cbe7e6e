//! What the benches share.

use criterion::Criterion;
use fnopt::gpu::{AdapterChoice, AdapterKind, Context};
use std::time::Duration;

/// Few samples and a short time each: a software adapter takes up to a second for a frame.
pub fn criterion() -> Criterion {
    Criterion::default()
        .sample_size(10)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1))
        .configure_from_args()
}

/// The best adapter, a software one included; without any the reason is printed.
pub fn adapter() -> Option<Context> {
    match Context::headless(&AdapterChoice::Best) {
        Ok(context) => Some(context),
        Err(error) => {
            eprintln!("nothing is measured on a GPU: {error}");
            None
        }
    }
}

/// Whether it runs on the host's processor.
pub fn is_software(context: &Context) -> bool {
    context.kind() == AdapterKind::Software
}
