//! Cloths in a web page: simulated and drawn on one device, with nothing copied in between but what the page says of them.
//!
//! `docs/embedding.md` says how to build it, under Browsers. `page.rs` is what the scripts beside it call.

#[cfg(target_arch = "wasm32")]
mod bodies;
#[cfg(target_arch = "wasm32")]
mod camera;
#[cfg(target_arch = "wasm32")]
#[path = "../host/draw.rs"]
mod draw;
#[cfg(target_arch = "wasm32")]
mod notices;
#[cfg(target_arch = "wasm32")]
mod page;
#[cfg(target_arch = "wasm32")]
mod scenes;
#[cfg(target_arch = "wasm32")]
mod session;
#[cfg(target_arch = "wasm32")]
mod settings;
#[cfg(target_arch = "wasm32")]
mod view;

fn main() {
    #[cfg(target_arch = "wasm32")]
    page::keep_panics();
    #[cfg(not(target_arch = "wasm32"))]
    eprintln!("This example runs in a browser; docs/embedding.md says how to build it, under Browsers.");
}
