//! The scenes that come with the library.

use super::Scene;
use crate::{Error, Result};
use std::path::Path;

/// A scene that comes with the library, to be had by its name ([`Scene::named`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NamedScene {
    /// Its name.
    pub name: &'static str,
    /// What happens in it, in one line.
    pub description: &'static str,
    /// Its scene file, as a start for a file of one's own. It names no other files, so it can be saved anywhere.
    pub text: &'static str,
}

/// The scene of `assets/scenes/NAME.json`.
macro_rules! scene {
    ($name:literal, $description:literal) => {
        NamedScene {
            name: $name,
            description: $description,
            text: include_str!(concat!("../../assets/scenes/", $name, ".json")),
        }
    };
}

const ALL: &[NamedScene] = &[
    scene!("sphere", "a sheet that drops on a ball and drapes over it"),
    scene!("table", "a round cloth that drops on a round table, which is a mesh"),
    scene!("edge", "a sheet that drops on the edge of a box and slides off it to the floor"),
    scene!("curtain", "a curtain on eight rings that a ball flies through at 10 m/s"),
    scene!("flag", "a flag tied to a pole at three points, in the wind"),
    scene!("cape", "a cape on the shoulders of a body that walks and turns"),
    scene!("twist", "two hands take a sheet by its sides, twist it, and one lets go"),
    scene!("pleats", "a flat sheet that falls from a rail and takes its six pleats"),
    scene!("fold-corner", "a sheet held at its centre and at a corner, which circles it, folds onto itself"),
    scene!("fold-edge", "a sheet held at the middle of an edge, which moves, folds onto itself"),
];

/// Returns the scenes that come with the library, each with a name of its own.
///
/// ```
/// for scene in fnopt::scene::named_scenes() {
///     println!("{}: {}", scene.name, scene.description);
/// }
/// ```
pub fn named_scenes() -> &'static [NamedScene] {
    ALL
}

impl NamedScene {
    /// Returns the scene called `name`; `origin` is the file or option that the name comes from.
    pub fn find(name: &str, origin: &str) -> Result<Self> {
        let found = ALL.iter().find(|scene| scene.name == name).copied();
        found.ok_or_else(|| Error::unknown(origin, "scene", name, ALL.iter().map(|scene| scene.name)))
    }

    /// Returns the scene, whose origin is its name.
    pub fn scene(&self) -> Result<Scene> {
        Scene::parse(self.text, self.name, Path::new(""))
    }
}

impl Scene {
    /// Returns the scene called `name` of those that come with the library ([`named_scenes`]). Fails with the nearest
    /// names if there is none.
    pub fn named(name: &str) -> Result<Self> {
        NamedScene::find(name, "Scene::named")?.scene()
    }
}
