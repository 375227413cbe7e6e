//! Cloths that are not the same everywhere: factors of mass and stiffness that lie on the sheet.

use super::picture::Picture;
use crate::Result;
use crate::cloth::{Grid, Map};
use crate::io::Node;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Factors of a property of the sheet, from a file.
#[derive(Clone, Debug, PartialEq)]
pub struct MapFile {
    /// A `.npy` of the factors, shape [H', W'] over the particles' rows and columns, or a `.png`, which the sheet wears as its
    /// texture.
    pub path: PathBuf,
    /// The factors of what is black or transparent and of what is white in a `.png`; `None` for a `.npy`.
    pub range: Option<[f64; 2]>,
}

/// Where a sheet is heavier or stiffer than elsewhere ([`Map`]).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapSettings {
    /// Factors of the mass per area.
    pub density: Option<MapFile>,
    /// Factors of stretch, shear and bend.
    pub stiffness: Option<MapFile>,
}

impl MapSettings {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Iterates over the files that it reads.
    pub(super) fn files_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        self.density.iter_mut().chain(&mut self.stiffness).map(|map| &mut map.path)
    }

    /// Iterates over the files that it reads.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        self.density.iter().chain(&self.stiffness).map(|map| &*map.path)
    }

    /// Reads `{"density", "stiffness"}`.
    pub(super) fn read(node: &Node, folder: &Path) -> Result<Self> {
        node.deny_unknown(&["density", "stiffness"])?;
        let map = |field: &str| node.get_or(field, None, |node| MapFile::read(node, folder).map(Some));
        Ok(Self { density: map("density")?, stiffness: map("stiffness")? })
    }

    /// Returns the settings as [`MapSettings::read`] reads them.
    pub(super) fn to_json(&self) -> Value {
        json!({
            "density": self.density.as_ref().map(MapFile::to_json),
            "stiffness": self.stiffness.as_ref().map(MapFile::to_json),
        })
    }
}

impl MapFile {
    /// Returns the factors at the particles of `grid`, interpolated. Fails if the file cannot be read, or a factor is out of
    /// [`Map::RANGE`].
    pub(super) fn on(&self, grid: Grid, field: &str) -> Result<Map> {
        let mut factors = Picture::read(&self.path, field)?.interpolated(grid);
        if let Some([black, white]) = self.range {
            factors.iter_mut().for_each(|factor| *factor = black + (white - black) * *factor);
        }
        Map::new(grid, &factors, &self.path.display().to_string(), field)
    }

    fn read(node: &Node, folder: &Path) -> Result<Self> {
        if node.value.is_string() {
            let path = folder.join(node.text()?);
            return match Picture::is_png(&path) {
                true => Err(node
                    .invalid("{\"file\": path, \"range\": [factor of black, factor of white]} for a .png")),
                false => Ok(Self { path, range: None }),
            };
        }
        if !node.value.is_object() {
            return Err(node.invalid("the path of a .npy, or {\"file\": path, \"range\"}"));
        }
        node.deny_unknown(&["file", "range"])?;
        let file = node.get("file").ok_or_else(|| node.invalid("{\"file\": path, \"range\"}"))?;
        let path = folder.join(file.text()?);
        let range = node.get_or("range", None, |range| {
            let [least, most] = Map::RANGE;
            let factors = range.array("two factors, of black and of white", Node::number)?;
            match factors.iter().all(|factor| (least..=most).contains(factor)) {
                true => Ok(Some(factors)),
                false => Err(range.invalid(format!("factors from {least} to {most}"))),
            }
        })?;
        match (Picture::is_png(&path), range) {
            (true, None) => {
                Err(node.invalid("a \"range\": [factor of black, factor of white] beside a .png"))
            }
            (false, Some(_)) => Err(node.invalid("no \"range\" beside a .npy, which holds the factors")),
            (_, range) => Ok(Self { path, range }),
        }
    }

    fn to_json(&self) -> Value {
        let path = self.path.to_string_lossy();
        match self.range {
            Some(range) => json!({ "file": path, "range": range }),
            None => json!(path),
        }
    }
}
