//! The C interface: `include/fnopt.h`, made from this module by cbindgen (docs/c.md).
//!
//! Scenes and simulations are opaque objects that the caller frees. Functions that can fail return a status and leave a
//! text, which [`fnopt_last_error`] returns on the same thread. All lengths, times and masses are in SI units, along the
//! axes of each scene.
//!
//! # Safety
//!
//! Of pointers, each function trusts its caller in this: objects are those that this library made and nobody has freed, texts
//! end with a zero, and arrays have as many elements as the arguments or their descriptions say. NULL where something is
//! needed is an error.

// Pointers of callers and names without mangling are what this module is for.
#![allow(unsafe_code, clippy::missing_safety_doc)]

mod check;
mod scene;
mod simulation;

pub use check::FnoptStatus;
pub use scene::{
    FnoptScene, fnopt_scene_default, fnopt_scene_free, fnopt_scene_load, fnopt_scene_parse,
    fnopt_scene_set_frames, fnopt_scene_set_grid,
};
pub use simulation::{
    FnoptControl, FnoptOptions, FnoptSimulation, FnoptStats, fnopt_cloths, fnopt_faces, fnopt_frame,
    fnopt_frame_time, fnopt_frames, fnopt_handles, fnopt_particles, fnopt_positions, fnopt_reset,
    fnopt_set_state, fnopt_simulation_free, fnopt_simulation_new, fnopt_stats, fnopt_step, fnopt_velocities,
};

use std::ffi::c_char;

/// Returns what was wrong with the last call on this thread that did not return FNOPT_STATUS_DONE, in UTF-8; an empty text if there
/// was none. It is valid until the next such call on this thread.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_last_error() -> *const c_char {
    check::last_error()
}

/// Returns the version of the library.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}
