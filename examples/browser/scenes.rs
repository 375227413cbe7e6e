//! The scenes of the page: those that come with the library, and the others of `assets/scenes`.

use fnopt::scene::{Scene, named_scenes};
use fnopt::serde_json::{Value, json};
use fnopt::{Error, Result};
use std::path::Path;

/// A scene of the page: its name, what happens in it, and its file.
type Entry = (&'static str, &'static str, &'static str);

macro_rules! scene {
    ($name:literal, $description:literal) => {
        ($name, $description, include_str!(concat!("../../assets/scenes/", $name, ".json")))
    };
}

const FIRST: Entry = scene!("default", "a sheet that hangs from two corners, which move");
const OTHERS: [Entry; 14] = [
    scene!("authors", "a scene file of the authors of the method"),
    scene!("cells", "a flat sheet held at three particles, which move up and down"),
    scene!("hanging", "a sheet held at the middle of an edge, which moves aside"),
    scene!("inline", "a small sheet whose start and motion are in the scene file"),
    scene!("moduli", "a sheet with moduli of its own, whose corners move"),
    scene!("npy_start", "a sheet that starts from the positions in a .npy file"),
    scene!("obj_start", "a tent that starts from the positions in an .obj file"),
    scene!("recorded", "a sheet whose corners follow a recorded motion"),
    scene!("rotation", "a sheet that turns about one of its corners"),
    scene!("speed", "the default scene, one and a half times as fast"),
    scene!("vertices", "a flat sheet that falls until its corners hold it"),
    scene!("wide", "a sheet three times as wide as high, whose corners move up and back"),
    scene!("wind", "a sheet that hangs from two corners in the wind"),
    scene!("z_up", "a sheet in wind, described with z up"),
];

/// Returns all scenes, those to show first in front.
fn all() -> impl Iterator<Item = Entry> {
    let named = named_scenes().iter().map(|scene| (scene.name, scene.description, scene.text));
    [FIRST].into_iter().chain(named).chain(OTHERS)
}

fn parse((name, _, text): Entry) -> Result<Scene> {
    let scene = Scene::parse(text, name, Path::new(""))?;
    if let Some(file) = scene.files().next() {
        let expected = "a scene without files, which a page cannot read";
        return Err(Error::invalid(name, "scene", expected, file.display()));
    }
    Ok(scene)
}

/// Returns the names and descriptions of all scenes, with what prevents those that a page cannot show, and whether each is
/// one of the gallery.
pub fn list() -> Value {
    let gallery = 1 + named_scenes().len();
    let entry = |(k, entry): (usize, Entry)| {
        let refused = parse(entry).err().map(|error| error.to_string());
        json!({ "name": entry.0, "description": entry.1, "refused": refused, "gallery": k < gallery })
    };
    all().enumerate().map(entry).collect()
}

/// Returns the scene called `name`. Fails with the nearest names if there is none, or if it needs files.
pub fn find(name: &str) -> Result<Scene> {
    let found = all().find(|entry| entry.0 == name);
    parse(found.ok_or_else(|| Error::unknown("page", "scene", name, all().map(|entry| entry.0)))?)
}
