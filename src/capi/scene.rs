//! Scenes.

use super::check::{FnoptStatus, give, missing, status, text, value};
use crate::Error;
use crate::bindings::{change_scene, find_scene};
use crate::scene::Scene;
use std::ffi::c_char;
use std::path::Path;

/// A cloth, the forces on it and the motion of its handles.
pub struct FnoptScene {
    pub(super) scene: Scene,
}

/// Makes the default scene: a sheet of 1 m that hangs from two corners, which move.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_default(scene: *mut *mut FnoptScene) -> FnoptStatus {
    // SAFETY: the caller's.
    status(|| unsafe { give(|| Ok(FnoptScene { scene: Scene::default() }), scene, "scene") })
}

/// Reads a scene file (JSON), or makes the scene of this name that comes with the library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_load(path: *const c_char, scene: *mut *mut FnoptScene) -> FnoptStatus {
    status(|| {
        // SAFETY: the caller's.
        let path = unsafe { text(path, "path") }?.ok_or_else(|| missing("path"))?;
        // SAFETY: the caller's.
        unsafe { give(|| Ok(FnoptScene { scene: find_scene(Path::new(path))? }), scene, "scene") }
    })
}

/// Parses the text of a scene file. Relative paths in it are those of `folder`, or of the current folder if it is NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_parse(
    json: *const c_char,
    folder: *const c_char,
    scene: *mut *mut FnoptScene,
) -> FnoptStatus {
    status(|| {
        // SAFETY: the caller's.
        let [json, folder] = unsafe { [text(json, "json")?, text(folder, "folder")?] };
        let (json, folder) = (json.ok_or_else(|| missing("json"))?, Path::new(folder.unwrap_or(".")));
        let folder = std::path::absolute(folder).map_err(|e| Error::io(folder, "cannot find", e))?;
        // SAFETY: the caller's.
        unsafe { give(|| Ok(FnoptScene { scene: Scene::parse(json, "scene", &folder)? }), scene, "scene") }
    })
}

/// Moves a scene to another grid, of 8 to 4096 particles along the height and the width, with its handles and its start.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_scene_set_grid(
    scene: Option<&mut FnoptScene>,
    height: usize,
    width: usize,
) -> FnoptStatus {
    status(|| {
        let scene = scene.ok_or_else(|| missing("scene"))?;
        change_scene(&mut scene.scene, Some([height, width]), None)
    })
}

/// Sets the number of frames of a scene, including the start. Fewer than it has are a part of it.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_scene_set_frames(scene: Option<&mut FnoptScene>, frames: usize) -> FnoptStatus {
    status(|| {
        let scene = scene.ok_or_else(|| missing("scene"))?;
        change_scene(&mut scene.scene, None, Some(frames))
    })
}

/// Frees a scene, which simulations of it do not need; NULL does nothing.
#[unsafe(no_mangle)]
pub extern "C" fn fnopt_scene_free(scene: Option<Box<FnoptScene>>) {
    value((), || drop(scene));
}
