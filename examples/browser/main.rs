//! A cloth in a web page: simulated and drawn on one device, with nothing copied in between.
//!
//! `docs/embedding.md` says how to build it, under Browsers.

#[cfg(target_arch = "wasm32")]
#[path = "../host/draw.rs"]
mod draw;
#[cfg(target_arch = "wasm32")]
mod page;

fn main() {
    #[cfg(target_arch = "wasm32")]
    page::start();
    #[cfg(not(target_arch = "wasm32"))]
    eprintln!("This example runs in a browser; docs/embedding.md says how to build it, under Browsers.");
}
