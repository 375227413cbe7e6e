//! Motions of the handles, built-in and recorded.
//!
//! All built-in motions share one timing: 0.5 s of rest, three moves of 1 s each over 1 m (there, back and
//! there again) with `s(t) = (1 - cos(pi t)) / 2`, then 3 s of rest. Axes are y up, in metres.

use super::{points, start::looks_like_a_path};
use crate::{Error, Result, io};
use ndarray::{ArrayD, Ix3};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};

const REST_BEFORE_S: f64 = 0.5;
const MOVES: f64 = 3.0;
const REST_AFTER_S: f64 = 3.0;
/// Name of the motion of handles that do not move.
pub(super) const STILL: &str = "none";

/// The path of a built-in motion, y up.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Course {
    /// All handles move 1 m in this direction, which need not have length 1.
    Along([f64; 3]),
    /// The handle of this index is fixed; the others circle the vertical axis through it, the farthest along
    /// an arc of 1 m.
    About(usize),
}

const COURSES: [(&str, Course); 15] = [
    ("fwd", Course::Along([1.0, 0.0, 0.0])),
    ("side", Course::Along([0.0, 0.0, 1.0])),
    ("updown", Course::Along([0.0, 1.0, 0.0])),
    ("xy", Course::Along([1.0, 0.0, 1.0])),
    ("yz", Course::Along([0.0, 1.0, 1.0])),
    ("xz", Course::Along([1.0, 1.0, 0.0])),
    ("xyz", Course::Along([1.0, 1.0, 1.0])),
    ("xy_v2", Course::Along([1.0, 0.0, -1.0])),
    ("yz_v2", Course::Along([0.0, 1.0, -1.0])),
    ("xz_v2", Course::Along([1.0, -1.0, 0.0])),
    ("xyz_v2", Course::Along([1.0, 1.0, -1.0])),
    ("xyz_v3", Course::Along([1.0, -1.0, 1.0])),
    ("xyz_v4", Course::Along([-1.0, 1.0, 1.0])),
    ("rot_h0", Course::About(0)),
    ("rot_h1", Course::About(1)),
];

/// One of the built-in motions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BuiltIn {
    name: &'static str,
    course: Course,
    opposite: bool,
}

impl BuiltIn {
    /// Duration of every built-in motion, from the start to the end of the last rest \[s\].
    pub const DURATION_S: f64 = REST_BEFORE_S + MOVES + REST_AFTER_S;

    /// Returns the built-in motion called `name`, such as `xy_v2` or `rot_h0_opp`.
    pub fn named(name: &str) -> Option<Self> {
        let (base, opposite) = name.strip_suffix("_opp").map_or((name, false), |base| (base, true));
        let &(name, course) = COURSES.iter().find(|(n, _)| *n == base)?;
        Some(Self { name, course, opposite })
    }

    /// Returns the names of all built-in motions.
    pub fn names() -> Vec<String> {
        let both = |(name, _): &(&str, Course)| [(*name).to_owned(), format!("{name}_opp")];
        COURSES.iter().flat_map(both).collect()
    }

    /// Returns the name.
    pub fn name(&self) -> String {
        format!("{}{}", self.name, if self.opposite { "_opp" } else { "" })
    }

    /// Returns the positions at time `t` \[s\] of handles that began at `start`; y up \[m\]. The handles rest
    /// before 0 and past the end.
    pub fn at(&self, t: f64, start: &[[f64; 3]]) -> Vec<[f64; 3]> {
        let sign = if self.opposite { -1.0 } else { 1.0 };
        let done = sign * progress(t);
        match self.course {
            Course::Along(direction) => {
                let length = points::norm(direction);
                let step = direction.map(|c| c / length * done);
                start.iter().map(|&p| points::zip(p, step, |p, s| p + s)).collect()
            }
            Course::About(named) => match start.get(named) {
                Some(&centre) => rotate(centre, done, start),
                None => start.to_vec(),
            },
        }
    }
}

/// Returns how far along its metre a motion is at time `t` \[s\]: 0 to 1.
fn progress(t: f64) -> f64 {
    let moving = (t - REST_BEFORE_S).clamp(0.0, MOVES);
    // There, back and there again: cos(pi t) runs smoothly through all three.
    0.5 * (1.0 - (PI * moving).cos())
}

/// Rotates the points about the vertical axis through `centre`, in the negative sense about +y, until the
/// farthest of them has moved along an arc of length `arc` \[m\].
fn rotate(centre: [f64; 3], arc: f64, points: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let radius = |p: &[f64; 3]| (p[0] - centre[0]).hypot(p[2] - centre[2]);
    let farthest = points.iter().map(radius).fold(0.0, f64::max);
    if farthest == 0.0 {
        return points.to_vec();
    }
    let (sin, cos) = (-arc / farthest).sin_cos();
    let turn = |p: &[f64; 3]| {
        let (x, z) = (p[0] - centre[0], p[2] - centre[2]);
        [centre[0] + x * cos + z * sin, p[1], centre[2] - x * sin + z * cos]
    };
    points.iter().map(turn).collect()
}

/// The motion of the handles of a scene.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Motion {
    /// The handles keep their positions in the start state.
    Still,
    /// A built-in motion.
    BuiltIn(BuiltIn),
    /// A `.npy` file of shape [frames, handles, 3] in metres and the scene's axes, one row per frame time.
    File(PathBuf),
    /// Positions of all handles at each frame time \[m\], in the scene's axes.
    Rows(Vec<Vec<[f64; 3]>>),
}

impl Motion {
    /// Parses the name of a built-in motion, `none`, or the path of a `.npy` file relative to `folder`.
    /// `origin` is the file or option that the text comes from.
    pub fn parse(text: &str, origin: &str, folder: &Path) -> Result<Self> {
        if text == STILL {
            Ok(Motion::Still)
        } else if text.to_ascii_lowercase().ends_with(".npy") {
            Ok(Motion::File(folder.join(text)))
        } else if let Some(built_in) = BuiltIn::named(text) {
            Ok(Motion::BuiltIn(built_in))
        } else if looks_like_a_path(text) {
            Err(Error::invalid(origin, "motion", "the name of a built-in motion or an .npy file", text))
        } else {
            let names = BuiltIn::names();
            let known = names.iter().map(String::as_str).chain([STILL]);
            Err(Error::unknown(origin, "motion", text, known))
        }
    }
}

impl std::fmt::Display for Motion {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Motion::Still => f.write_str(STILL),
            Motion::BuiltIn(motion) => f.write_str(&motion.name()),
            Motion::File(path) => write!(f, "{}", path.display()),
            Motion::Rows(rows) => write!(f, "{} rows of positions", rows.len()),
        }
    }
}

/// Recorded handle positions \[m\], in the axes of their file.
#[derive(Clone, Debug)]
pub(super) struct Recording {
    points: Vec<[f64; 3]>,
    handles: usize,
}

impl Recording {
    /// Reads a `.npy` of shape [frames, `handles`, 3].
    pub fn read(path: &Path, handles: usize) -> Result<Self> {
        let origin = path.display().to_string();
        let array: ArrayD<f64> = io::read_npy(path)?;
        let found = format!("{:?}", array.shape());
        let fits = array.view().into_dimensionality::<Ix3>().is_ok_and(|a| {
            let (f, h, c) = a.dim();
            f > 0 && h == handles && c == 3
        });
        if !fits {
            let expected = format!("[frames, {handles}, 3], {handles} being the number of handles");
            return Err(Error::invalid(origin, "shape", expected, found));
        }
        Ok(Self { points: points::from_array(&origin, &array)?, handles })
    }

    /// Takes rows of `handles` positions each; `origin` names the scene.
    pub fn from_rows(rows: &[Vec<[f64; 3]>], handles: usize, origin: &str) -> Result<Self> {
        if rows.is_empty() {
            return Err(Error::invalid(origin, "motion", "at least one row of positions", "none"));
        }
        if let Some(k) = rows.iter().position(|row| row.len() != handles) {
            let expected = format!("{handles} positions, one for each handle");
            return Err(Error::invalid(origin, format!("motion[{k}]"), expected, rows[k].len()));
        }
        Ok(Self { points: rows.concat(), handles })
    }

    /// Returns the number of recorded frames, at least one.
    pub fn frames(&self) -> usize {
        self.points.len() / self.handles
    }

    /// Returns the positions at a fractional frame, interpolated linearly; past the end, those of the last
    /// frame.
    pub fn at(&self, frame: f64) -> Vec<[f64; 3]> {
        let last = self.frames() - 1;
        let row = |k: usize| &self.points[k.min(last) * self.handles..][..self.handles];
        let before = (frame.max(0.0) as usize).min(last);
        let t = (frame - before as f64).clamp(0.0, 1.0);
        let mix = |(p, q): (&[f64; 3], &[f64; 3])| std::array::from_fn(|c| p[c] + t * (q[c] - p[c]));
        row(before).iter().zip(row(before + 1)).map(mix).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for name in BuiltIn::names() {
            assert_eq!(BuiltIn::named(&name).map(|m| m.name()), Some(name));
        }
        assert_eq!(BuiltIn::names().len(), 30);
    }

    #[test]
    fn opposite_translations_mirror_the_course() {
        let at = |name| BuiltIn::named(name).unwrap().at(1.1, &[[1.0, 2.0, 3.0]])[0];
        let (there, back) = (at("xyz_v4"), at("xyz_v4_opp"));
        for c in 0..3 {
            assert!((there[c] + back[c] - 2.0 * [1.0, 2.0, 3.0][c]).abs() < 1e-15);
        }
    }

    #[test]
    fn a_single_handle_is_kept_by_a_rotation() {
        let start = [[0.1, 0.2, 0.3]];
        for name in ["rot_h0", "rot_h1", "rot_h1_opp"] {
            assert_eq!(BuiltIn::named(name).unwrap().at(1.3, &start), start);
        }
    }
}
