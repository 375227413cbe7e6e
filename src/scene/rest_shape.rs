//! The shape of a sheet at rest: creases, pleats and curls.

use crate::cloth::{Grid, RestAngles};
use crate::io::Node;
use crate::{Error, Result};
use serde_json::{Value, json};

/// Most pleats of a sheet.
const MOST_PLEATS: usize = 1000;

/// How a sheet is bent where nothing pulls at it ([`RestAngles`]). Angles and curvatures turn it towards its front if
/// they are positive: the side on which its texture is not mirrored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestShape {
    /// Lines along which it is folded.
    pub creases: Vec<Crease>,
    /// Curvature between them [1/m], along the height and along the width.
    pub curvature_per_m: [f64; 2],
}

/// A line along which a sheet is folded, from one border to the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crease {
    /// Where it is.
    pub line: CreaseLine,
    /// The angle by which the sheet turns there \[degrees\], between -180 and 180.
    pub angle_deg: f64,
}

/// Where a crease is, in texture coordinates. It is moved to the nearest row or column of particles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CreaseLine {
    /// The line of this u, which lies across the height.
    U(f64),
    /// The line of this v, which lies across the width.
    V(f64),
}

impl CreaseLine {
    /// Returns the axis that the crease turns, 0 for the height, and its place there.
    fn place(self) -> (usize, f64) {
        match self {
            Self::U(u) => (0, u),
            Self::V(v) => (1, v),
        }
    }
}

impl RestShape {
    /// Whether the sheet is flat.
    pub fn is_flat(&self) -> bool {
        *self == Self::default()
    }

    /// Returns the angles of the particles of a grid with edges of this length, or `None` for a flat sheet. Fails if
    /// a crease does not lie within the sheet, or an angle is not between -180 and 180 degrees; `origin` names the
    /// scene.
    pub(super) fn on(&self, grid: Grid, length_m: f64, origin: &str) -> Result<Option<RestAngles>> {
        if self.is_flat() {
            return Ok(None);
        }
        let counts = [grid.h, grid.w];
        // Of each row, and of each column.
        let mut angles = [0, 1].map(|axis| vec![self.curvature_per_m[axis] * length_m; counts[axis]]);
        for (k, crease) in self.creases.iter().enumerate() {
            let (axis, place) = crease.line.place();
            if !(place > 0.0 && place < 1.0) {
                let field = format!("rest_shape.creases[{k}].{}", ["u", "v"][axis]);
                return Err(Error::invalid(origin, field, "a number between 0 and 1, without these", place));
            }
            let last = counts[axis] - 1;
            let nearest = ((1.0 - place) * last as f64).round() as usize;
            angles[axis][nearest.clamp(1, last - 1)] += crease.angle_deg.to_radians();
        }
        let each = (0..grid.particles()).map(|p| [angles[0][p / grid.w], angles[1][p % grid.w]]);
        RestAngles::new(grid, &each.collect::<Vec<_>>(), origin, "rest_shape").map(Some)
    }

    /// Reads `{"creases", "pleats", "curvature_per_m"}`; pleats become creases.
    pub(super) fn read(node: &Node) -> Result<Self> {
        node.deny_unknown(&["creases", "pleats", "curvature_per_m"])?;
        let mut creases: Vec<Crease> =
            node.get_or("creases", Vec::new(), |n| n.items()?.iter().map(Crease::read).collect())?;
        creases.extend(node.get_or("pleats", Vec::new(), read_pleats)?);
        let pair = |n: &Node| n.array("two curvatures, along the height and along the width", Node::number);
        Ok(Self { creases, curvature_per_m: node.get_or("curvature_per_m", [0.0; 2], pair)? })
    }

    /// Returns the shape as [`RestShape::read`] reads it.
    pub(super) fn to_json(&self) -> Value {
        let creases: Vec<Value> = self.creases.iter().map(|crease| crease.to_json()).collect();
        json!({ "creases": creases, "curvature_per_m": self.curvature_per_m })
    }
}

impl Crease {
    fn read(node: &Node) -> Result<Self> {
        node.deny_unknown(&["u", "v", "angle"])?;
        let angle = node.get("angle").ok_or_else(|| node.invalid("an \"angle\" [degrees]"))?;
        let line = match (node.get("u"), node.get("v")) {
            (Some(u), None) => CreaseLine::U(u.number()?),
            (None, Some(v)) => CreaseLine::V(v.number()?),
            _ => return Err(node.invalid("either \"u\" or \"v\", where the crease is")),
        };
        Ok(Self { line, angle_deg: read_angle(&angle)? })
    }

    fn to_json(self) -> Value {
        match self.line {
            CreaseLine::U(u) => json!({ "u": u, "angle": self.angle_deg }),
            CreaseLine::V(v) => json!({ "v": v, "angle": self.angle_deg }),
        }
    }
}

/// Reads `{"count", "angle", "along"}`: as many creases, the first and the last half as far from the borders as from
/// each other, which turn one way and the other by the same angle.
fn read_pleats(node: &Node) -> Result<Vec<Crease>> {
    node.deny_unknown(&["count", "angle", "along"])?;
    let field = |name: &str, what: &str| node.get(name).ok_or_else(|| node.invalid(what));
    let count = field("count", "a \"count\" of pleats")?;
    let angle = read_angle(&field("angle", "an \"angle\" [degrees]")?)?;
    let line: fn(f64) -> CreaseLine = match node.get("along") {
        None => CreaseLine::U,
        Some(along) => match along.text()? {
            "u" => CreaseLine::U,
            "v" => CreaseLine::V,
            _ => return Err(along.invalid("\"u\" or \"v\", the direction in which pleats follow each other")),
        },
    };
    let pleats = match count.count()? {
        pleats @ 1..=MOST_PLEATS => pleats,
        _ => return Err(count.invalid(format!("1 to {MOST_PLEATS} pleats"))),
    };
    let pleat = |k: usize| Crease {
        line: line((k as f64 + 0.5) / pleats as f64),
        angle_deg: if k.is_multiple_of(2) { angle } else { -angle },
    };
    Ok((0..pleats).map(pleat).collect())
}

fn read_angle(node: &Node) -> Result<f64> {
    match node.number()? {
        angle if angle.abs() < 180.0 => Ok(angle),
        _ => Err(node.invalid("an angle between -180 and 180 degrees")),
    }
}
