//! Cloths that are not a full rectangle: which part of the sheet is left.

use super::Units;
use super::picture::Picture;
use super::start::looks_like_a_path;
use crate::cloth::{Grid, Mask};
use crate::io::Node;
use crate::{Error, Result};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// A part of a sheet. Places on it are (u, v), each 0 to 1: those of its texture, with u to the right and v up on a sheet
/// that hangs from its edge j = 0, seen from the side of its normals ([`Grid::texture_coordinates`]).
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Region {
    /// `disc`: the largest disc in the middle of the sheet.
    Disc,
    /// `triangle`: from the two corners of the edge j = 0 to the middle of the opposite edge.
    Triangle,
    /// A circle.
    Circle {
        /// Its centre (u, v).
        centre: [f64; 2],
        /// Its radius \[m\].
        radius_m: f64,
    },
    /// What lies inside a polygon with these corners (u, v), by the even-odd rule.
    Polygon(Vec<[f64; 2]>),
    /// What is bright and opaque in a `.png`, which the sheet wears as its texture, or not zero in a `.npy` of any shape
    /// [H', W'] over the particles' rows and columns.
    File(PathBuf),
}

/// The part of the sheet that a cloth has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MaskSettings {
    /// What is kept; `None` for the whole sheet.
    pub outline: Option<Region>,
    /// What is cut out of it.
    pub holes: Vec<Region>,
}

/// Names of the regions that need no numbers.
const NAMES: [&str; 2] = ["disc", "triangle"];

/// How far a place may lie off a border and still count as on it \[edges\].
const ON_BORDER: f64 = 1e-6;

impl MaskSettings {
    /// Returns the particles of `grid` that the cloth has. Fails if a file cannot be read, or nothing is left.
    pub(super) fn on(&self, grid: Grid, units: &Units, origin: &str) -> Result<Mask> {
        let mut wanted = match &self.outline {
            None => vec![true; grid.particles()],
            Some(region) => region.covers(grid, units, true)?,
        };
        for hole in &self.holes {
            let covered = hole.covers(grid, units, false)?;
            wanted.iter_mut().zip(covered).for_each(|(wanted, covered)| *wanted &= !covered);
        }
        Mask::new(grid, &wanted, origin)
    }

    /// Iterates over the files that it reads.
    pub(super) fn files_mut(&mut self) -> impl Iterator<Item = &mut PathBuf> {
        let regions = self.outline.iter_mut().chain(&mut self.holes);
        regions.filter_map(|region| if let Region::File(path) = region { Some(path) } else { None })
    }

    /// Iterates over the files that it reads.
    pub(super) fn files(&self) -> impl Iterator<Item = &Path> {
        let regions = self.outline.iter().chain(&self.holes);
        regions.filter_map(|region| if let Region::File(path) = region { Some(&**path) } else { None })
    }

    /// Reads a region, or `{"outline", "holes"}`.
    pub(super) fn read(node: &Node, folder: &Path) -> Result<Self> {
        if node.get("outline").is_none() && node.get("holes").is_none() {
            return Ok(Self { outline: Some(Region::read(node, folder)?), holes: Vec::new() });
        }
        node.deny_unknown(&["outline", "holes"])?;
        let region = |node: &Node| Region::read(node, folder);
        Ok(Self {
            outline: node.get_or("outline", None, |node| region(node).map(Some))?,
            holes: node.get_or("holes", Vec::new(), |node| node.items()?.iter().map(region).collect())?,
        })
    }

    /// Returns the settings as [`MaskSettings::read`] reads them.
    pub(super) fn to_json(&self) -> Value {
        let holes: Vec<Value> = self.holes.iter().map(Region::to_json).collect();
        match &self.outline {
            Some(outline) => json!({ "outline": outline.to_json(), "holes": holes }),
            None => json!({ "holes": holes }),
        }
    }
}

impl Region {
    /// Returns which particles lie in the region; those on its border only if they are `inclusive`.
    fn covers(&self, grid: Grid, units: &Units, inclusive: bool) -> Result<Vec<bool>> {
        let (height, width) = ((grid.h - 1) as f64, (grid.w - 1) as f64);
        let slack = if inclusive { ON_BORDER } else { -ON_BORDER };
        // From u and v to edges.
        let place = |[u, v]: [f64; 2]| [u * height, v * width];
        let own = |p: usize| [height - (p / grid.w) as f64, width - (p % grid.w) as f64];
        let each = |test: &dyn Fn([f64; 2]) -> bool| (0..grid.particles()).map(|p| test(own(p))).collect();
        let circle = |centre: [f64; 2], radius: f64| {
            let [x, y] = place(centre);
            each(&|[u, v]| (u - x).hypot(v - y) <= radius + slack)
        };
        let polygon = |corners: &[[f64; 2]]| {
            let corners: Vec<_> = corners.iter().map(|&corner| place(corner)).collect();
            each(&|at| match distance_to(&corners, at) <= ON_BORDER {
                true => inclusive,
                false => is_inside(&corners, at),
            })
        };
        Ok(match self {
            Region::Disc => circle([0.5, 0.5], 0.5 * height.min(width)),
            Region::Triangle => polygon(&[[0.0, 1.0], [1.0, 1.0], [0.5, 0.0]]),
            Region::Circle { centre, radius_m } => circle(*centre, radius_m / units.length_m),
            Region::Polygon(corners) => polygon(corners),
            Region::File(path) if Picture::is_png(path) => {
                Picture::read(path, "mask")?.nearest(grid).iter().map(|value| *value >= 0.5).collect()
            }
            Region::File(path) => {
                Picture::read(path, "mask")?.nearest(grid).iter().map(|value| *value != 0.0).collect()
            }
        })
    }

    fn read(node: &Node, folder: &Path) -> Result<Self> {
        const EXPECTED: &str = "\"disc\", \"triangle\", {\"circle\": [u, v], \"radius_m\"}, {\"polygon\": [[u, v], ..]} or \
             the path of a .png or .npy";
        if let Value::String(text) = node.value {
            return match text.as_str() {
                "disc" => Ok(Region::Disc),
                "triangle" => Ok(Region::Triangle),
                path if looks_like_a_path(path) => Ok(Region::File(folder.join(path))),
                other => {
                    Err(Error::unknown(format!("{}: {}", node.origin, node.path), "region", other, NAMES))
                }
            };
        }
        if !node.value.is_object() {
            return Err(node.invalid(EXPECTED));
        }
        node.deny_unknown(&["circle", "radius_m", "polygon"])?;
        let place = |node: &Node| {
            let place = node.array("a place [u, v]", Node::number)?;
            match place.iter().all(|c| (0.0..=1.0).contains(c)) {
                true => Ok(place),
                false => Err(node.invalid("a place [u, v] on the sheet, each from 0 to 1")),
            }
        };
        match (node.get("circle"), node.get("radius_m"), node.get("polygon")) {
            (Some(centre), Some(radius), None) => {
                let radius_m = radius.number()?;
                if radius_m <= 0.0 {
                    return Err(radius.invalid("a number above 0"));
                }
                Ok(Region::Circle { centre: place(&centre)?, radius_m })
            }
            (None, None, Some(polygon)) => {
                let corners = polygon.items()?.iter().map(place).collect::<Result<Vec<_>>>()?;
                if corners.len() < 3 {
                    return Err(polygon.invalid("three corners or more"));
                }
                Ok(Region::Polygon(corners))
            }
            _ => Err(node.invalid(EXPECTED)),
        }
    }

    fn to_json(&self) -> Value {
        match self {
            Region::Disc => json!(NAMES[0]),
            Region::Triangle => json!(NAMES[1]),
            Region::Circle { centre, radius_m } => json!({ "circle": centre, "radius_m": radius_m }),
            Region::Polygon(corners) => json!({ "polygon": corners }),
            Region::File(path) => json!(path.to_string_lossy()),
        }
    }
}

/// Iterates over the sides of a polygon.
fn sides(corners: &[[f64; 2]]) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
    corners.iter().copied().zip(corners.iter().copied().cycle().skip(1)).map(|(a, b)| [a, b])
}

/// Returns the distance of a place from the border of a polygon.
fn distance_to(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> f64 {
    let to_side = |[[x0, y0], [x1, y1]]: [[f64; 2]; 2]| {
        let (dx, dy) = (x1 - x0, y1 - y0);
        let square = dx * dx + dy * dy;
        let along = ((x - x0) * dx + (y - y0) * dy) / square;
        let along = if square > 0.0 { along.clamp(0.0, 1.0) } else { 0.0 };
        (x - x0 - along * dx).hypot(y - y0 - along * dy)
    };
    sides(corners).map(to_side).fold(f64::INFINITY, f64::min)
}

/// Whether a line from the place to the right crosses the border an odd number of times.
fn is_inside(corners: &[[f64; 2]], [x, y]: [f64; 2]) -> bool {
    let crosses = |[[x0, y0], [x1, y1]]: [[f64; 2]; 2]| {
        (y0 > y) != (y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
    };
    sides(corners).filter(|&side| crosses(side)).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRID: Grid = Grid { h: 33, w: 33 };

    fn count(text: &str) -> Result<usize> {
        let value = serde_json::from_str(text).unwrap();
        let settings = MaskSettings::read(&Node::root("test", &value), Path::new(""))?;
        assert_eq!(settings, MaskSettings::read(&Node::root("test", &settings.to_json()), Path::new(""))?);
        let units = Units { length_m: 1.0 / 32.0, frame_time_s: 1.0 / 60.0, areal_mass_kg_m2: 0.187 };
        let mask = settings.on(GRID, &units, "test")?;
        Ok(mask.inside().iter().filter(|&&inside| inside).count())
    }

    #[test]
    fn regions_have_their_area() {
        let all = GRID.particles() as f64;
        for (text, area) in [
            (r#""disc""#, std::f64::consts::PI / 4.0),
            (r#""triangle""#, 0.5),
            (r#"{"circle": [0.5, 0.5], "radius_m": 0.25}"#, std::f64::consts::PI / 16.0),
            (r#"{"polygon": [[0, 0], [1, 0], [1, 1], [0, 1]]}"#, 1.0),
            (r#"{"polygon": [[0, 0.5], [0.5, 1], [1, 0.5], [0.5, 0]]}"#, 0.5),
            (r#"{"holes": [{"circle": [0.5, 0.5], "radius_m": 0.25}]}"#, 1.0 - std::f64::consts::PI / 16.0),
        ] {
            let found = count(text).unwrap() as f64 / all;
            assert!((found - area).abs() < 0.06, "{text}: {found} for {area}");
        }
        assert_eq!(count(r#"{"polygon": [[0, 0], [1, 0], [1, 1], [0, 1]]}"#).unwrap(), GRID.particles());
    }

    #[test]
    fn wrong_regions_are_refused() {
        for (text, expected) in [
            (r#""disk""#, "did you mean disc"),
            (r#"{"circle": [0.5, 1.5], "radius_m": 0.2}"#, "from 0 to 1"),
            (r#"{"circle": [0.5, 0.5]}"#, "radius_m"),
            (r#"{"circle": [0.5, 0.5], "radius_m": 0}"#, "above 0"),
            (r#"{"circle": [0.5, 0.5], "radius_m": 0.001}"#, "at least one cell"),
            (r#"{"polygon": [[0, 0], [1, 1]]}"#, "three corners"),
            (r#"{"outlin": "disc"}"#, "outlin"),
            (r#"{"outline": "disc", "hole": []}"#, "hole"),
            ("3", "disc"),
        ] {
            let error = count(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    /// A diamond: its border at 45 degrees.
    #[test]
    fn borders_belong_to_outlines_and_not_to_holes() {
        let diamond = r#"{"polygon": [[0, 0.5], [0.5, 1], [1, 0.5], [0.5, 0]]}"#;
        let outline = count(diamond).unwrap();
        let hole = count(&format!(r#"{{"holes": [{diamond}]}}"#)).unwrap();
        // Of a diamond with 16 edges from its centre to its corners 2 16^2 + 2 16 + 1 particles lie in it or on its border, and
        // 2 15^2 + 2 15 + 1 inside. Its corners belong to no whole cell, on either side.
        assert_eq!((outline, hole), (545 - 4, GRID.particles() - 481 - 4));
    }
}
