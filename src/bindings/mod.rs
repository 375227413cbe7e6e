//! What the interfaces to other languages share: solvers and devices by name, scenes by name or file, reports.

// C needs a part of it.
#![cfg_attr(not(feature = "python"), allow(dead_code, unused_imports))]

#[cfg(feature = "python")]
mod report;
mod settings;

#[cfg(feature = "python")]
pub(crate) use report::{Report, Status};
pub(crate) use settings::{Settings, solvers};

use crate::cloth::Grid;
use crate::scene::{NamedScene, Scene};
use crate::{Error, Result};
use std::path::Path;

/// Returns the scene of a file, or the one of this name that comes with the library. A file that exists goes before a
/// scene of the same name.
pub(crate) fn find_scene(path: &Path) -> Result<Scene> {
    let is_file = path.exists() && !path.is_dir();
    match path.to_str() {
        Some(name) if !is_file && !name.contains(['.', '/', '\\']) => match NamedScene::find(name, "scene") {
            Err(Error::Unknown { origin, kind, name, hint }) => {
                let hint = format!("{hint}, and no file of this name");
                Err(Error::Unknown { origin, kind, name, hint })
            }
            found => found?.scene(),
        },
        _ => Scene::load(path),
    }
}

/// Changes grid and frames of a scene. Fewer frames than it has are a part of it, without the events of the others.
pub(crate) fn change_scene(scene: &mut Scene, grid: Option<[usize; 2]>, frames: Option<usize>) -> Result<()> {
    if let Some([h, w]) = grid {
        scene.regrid(Grid::new(h, w, &scene.origin)?)?;
    }
    if let Some(frames) = frames {
        if frames == 0 {
            return Err(Error::invalid(&scene.origin, "frames", "1 or more", 0));
        }
        scene.frames = Some(frames);
        scene.events.retain(|event| event.frame < frames);
    }
    Ok(())
}
