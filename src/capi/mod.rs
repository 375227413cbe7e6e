//! The C interface: `include/fnopt.h`, made from this module by cbindgen (docs/c.md).
//!
//! Scenes and simulations are opaque objects that the caller frees. Functions that can fail return a status and leave a
//! text, which [`fnopt_last_error`] returns on the same thread. All lengths, times and masses are in SI units, along the
//! axes of each scene.

// Pointers of callers and names without mangling are what this module is for: each function says what it trusts.
#![allow(unsafe_code)]

mod check;
mod scene;
mod simulation;

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

/// How a call ended: the exit codes of the command.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum FnoptStatus {
    /// Done.
    Done = 0,
    /// Bad input or environment: an argument, a file, a device.
    BadInput = 2,
    /// The simulation became non-finite; its state can still be read and replaced.
    NonFinite = 3,
}

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

#[cfg(test)]
mod tests {
    use std::path::Path;

    /// Returns the names of the functions of this module's sources, each with the number of its arguments.
    fn functions(source: &str) -> Vec<(String, usize)> {
        let declared = source.split("extern \"C\" fn ").skip(1).filter(|rest| rest.starts_with("fnopt_"));
        let arguments = |list: &str| list.split(',').filter(|argument| !argument.trim().is_empty()).count();
        let found = declared.map(|rest| {
            let (name, rest) = rest.split_once('(').expect("arguments");
            (name.to_owned(), arguments(rest.split_once(')').expect("an end of the arguments").0))
        });
        found.collect()
    }

    #[test]
    fn the_header_declares_every_function_with_its_arguments() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let sources = ["mod", "scene", "simulation"].map(|name| root.join(format!("src/capi/{name}.rs")));
        let text = sources.map(|path| std::fs::read_to_string(path).expect("a source file")).concat();
        let header = std::fs::read_to_string(root.join("include/fnopt.h")).expect("include/fnopt.h");
        let mut all = functions(&text);
        all.sort();
        let declared = header.split("fnopt_").skip(1).filter_map(|rest| {
            let (name, rest) = rest.split_once('(')?;
            let list = rest.split_once(')')?.0;
            let is_name = name.chars().all(|c| c.is_ascii_lowercase() || c == '_');
            let count = if list == "void" { 0 } else { list.split(',').count() };
            (is_name && rest.split_once(')')?.1.starts_with(';')).then(|| (format!("fnopt_{name}"), count))
        });
        let mut declared: Vec<_> = declared.collect();
        declared.sort();
        assert_eq!(declared, all, "run cbindgen --output include/fnopt.h");
        assert!(all.len() > 15);
    }
}
