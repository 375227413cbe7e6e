//! Scenes.

use super::FnoptStatus;
use super::check::{missing, status, text, value};
use crate::bindings::{change_scene, find_scene};
use crate::scene::Scene;
use crate::{Error, Result};
use std::ffi::c_char;
use std::path::Path;

/// A cloth, the forces on it and the motion of its handles.
pub struct FnoptScene {
    pub(super) scene: Scene,
}

/// Makes the default scene: a sheet of 1 m that hangs from two corners, which move.
///
/// # Safety
///
/// `scene` points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_default(scene: *mut *mut FnoptScene) -> FnoptStatus {
    // SAFETY: as above.
    status(|| unsafe { give(Scene::default(), scene) })
}

/// Reads a scene file (JSON), or makes the scene of this name that comes with the library.
///
/// # Safety
///
/// `path` is a text that ends with a zero; `scene` points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_load(path: *const c_char, scene: *mut *mut FnoptScene) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let path = unsafe { text(path, "path") }?.ok_or_else(|| missing("path"))?;
        // SAFETY: as above.
        unsafe { give(find_scene(Path::new(path))?, scene) }
    })
}

/// Parses the text of a scene file. Relative paths in it are those of `folder`, or of the current folder if it is NULL.
///
/// # Safety
///
/// `json` is a text that ends with a zero, `folder` one or NULL; `scene` points to room for a pointer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_parse(
    json: *const c_char,
    folder: *const c_char,
    scene: *mut *mut FnoptScene,
) -> FnoptStatus {
    status(|| {
        // SAFETY: as above.
        let json = unsafe { text(json, "json") }?.ok_or_else(|| missing("json"))?;
        // SAFETY: as above.
        let folder = Path::new(unsafe { text(folder, "folder") }?.unwrap_or("."));
        let folder = std::path::absolute(folder).map_err(|e| Error::io(folder, "cannot find", e))?;
        // SAFETY: as above.
        unsafe { give(Scene::parse(json, "scene", &folder)?, scene) }
    })
}

/// Moves a scene to another grid, of 8 to 4096 particles along the height and the width, with its handles and its start.
///
/// # Safety
///
/// `scene` is a scene of this library that no other thread uses meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_set_grid(
    scene: *mut FnoptScene,
    height: usize,
    width: usize,
) -> FnoptStatus {
    // SAFETY: as above.
    status(|| change_scene(unsafe { change(scene) }?, Some([height, width]), None))
}

/// Sets the number of frames of a scene, including the start. Fewer than it has are a part of it.
///
/// # Safety
///
/// `scene` is a scene of this library that no other thread uses meanwhile.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_set_frames(scene: *mut FnoptScene, frames: usize) -> FnoptStatus {
    // SAFETY: as above.
    status(|| change_scene(unsafe { change(scene) }?, None, Some(frames)))
}

/// Frees a scene, which simulations of it do not need; NULL does nothing.
///
/// # Safety
///
/// `scene` is NULL or a scene of this library that has not been freed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fnopt_scene_free(scene: *mut FnoptScene) {
    value((), || {
        if !scene.is_null() {
            // SAFETY: `give` made it from a box.
            drop(unsafe { Box::from_raw(scene) });
        }
    });
}

/// Hands a scene to the caller.
unsafe fn give(scene: Scene, to: *mut *mut FnoptScene) -> Result<()> {
    if to.is_null() {
        return Err(missing("scene"));
    }
    // SAFETY: the caller's.
    unsafe { to.write(Box::into_raw(Box::new(FnoptScene { scene }))) };
    Ok(())
}

unsafe fn change<'a>(scene: *mut FnoptScene) -> Result<&'a mut Scene> {
    // SAFETY: the caller's.
    unsafe { scene.as_mut() }.map(|scene| &mut scene.scene).ok_or_else(|| missing("scene"))
}
