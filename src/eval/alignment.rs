//! Whether another system's trajectory begins where the truth does, and if not, what was probably mixed up.

use super::Sequence;
use super::resampling::Resampling;
use crate::cloth::Grid;
use crate::io::Trajectory;
use crate::{Error, Result};

/// Mean distance between two starts, over the side of the cloth, that needs no remark.
const NEAR: f64 = 0.05;
/// The same once the mistake is undone: that of a start that was only rounded or resampled.
const SAME: f64 = 0.02;
/// Factors between the units that files use.
const FACTORS: [f64; 7] = [1.0, 10.0, 100.0, 1000.0, 0.1, 0.01, 0.001];
const AXES: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];

/// A way in which positions may have been mixed up.
#[derive(Clone, Copy)]
struct Mistake {
    /// How many times too large they are.
    factor: f64,
    /// Which axis of the file each of ours is, and its sign.
    axes: [usize; 3],
    signs: [f64; 3],
    /// Whether rows and columns are reversed or exchanged.
    rows: bool,
    columns: bool,
    transposed: bool,
}

impl Mistake {
    /// Number of things that it takes to be wrong.
    fn parts(&self) -> usize {
        let turned = self.axes != AXES[0] || self.signs.contains(&-1.0);
        [self.factor != 1.0, turned, self.rows, self.columns, self.transposed]
            .into_iter()
            .filter(|&p| p)
            .count()
    }

    /// Undoes it at particle (i, j).
    fn undo(&self, points: &[[f64; 3]], Grid { h, w }: Grid, (i, j): (usize, usize)) -> [f64; 3] {
        let (i, j) = if self.transposed { (j, i) } else { (i, j) };
        let i = if self.rows { h - 1 - i } else { i };
        let j = if self.columns { w - 1 - j } else { j };
        let p = points[i * w + j];
        [0, 1, 2].map(|c| self.signs[c] * p[self.axes[c]] / self.factor)
    }

    fn describe(&self) -> String {
        let mut parts = Vec::new();
        if self.factor > 1.0 {
            parts.push(format!("positions {} times too large", self.factor));
        } else if self.factor < 1.0 {
            parts.push(format!("positions {} times too small", (1.0 / self.factor).round()));
        }
        if self.axes != AXES[0] || self.signs.contains(&-1.0) {
            let name = |c: usize| {
                let sign = if self.signs[c] < 0.0 { "-" } else { "" };
                format!("{sign}{}", ["x", "y", "z"][self.axes[c]])
            };
            parts.push(format!("other axes: our x, y, z are its {}, {}, {}", name(0), name(1), name(2)));
        }
        let orders = [
            (self.rows, "rows in reverse order"),
            (self.columns, "columns in reverse order"),
            (self.transposed, "rows and columns exchanged"),
        ];
        parts.extend(orders.into_iter().filter(|(is, _)| *is).map(|(_, text)| text.to_owned()));
        parts.join(", ")
    }
}

/// Compares frame 0 of another system's trajectory, on any grid, with the truth's. Fails, and says what is probably mixed
/// up, if a factor, other axes or another order of the vertices explains a large distance; warns if nothing does.
pub(super) fn check_start(sequence: &Sequence, name: &str, found: &Trajectory) -> Result<()> {
    let (truth, grid) = (&sequence.truth, sequence.truth.grid());
    let wide = |points: &[[f32; 3]]| points.iter().map(|p| p.map(f64::from)).collect::<Vec<_>>();
    let (own, start) = (wide(found.frame(0)), wide(truth.frame(0)));
    if found.grid().h < 2 || found.grid().w < 2 || own.iter().flatten().any(|c| !c.is_finite()) {
        return Ok(());
    }
    let own = Resampling::new(found.grid(), grid).apply(&own);
    let apart = |mistake: &Mistake| {
        let distance = |p: usize| {
            let at = mistake.undo(&own, grid, (p / grid.w, p % grid.w));
            (0..3).map(|c| (at[c] - start[p][c]).powi(2)).sum::<f64>().sqrt()
        };
        (0..start.len()).map(distance).sum::<f64>() / start.len() as f64 / sequence.side_m()
    };
    let none = Mistake {
        factor: 1.0,
        axes: AXES[0],
        signs: [1.0; 3],
        rows: false,
        columns: false,
        transposed: false,
    };
    let now = apart(&none);
    if now <= NEAR {
        return Ok(());
    }
    let mut mistakes = Vec::new();
    for factor in FACTORS {
        for (axes, signs) in AXES.into_iter().flat_map(|axes| (0..8).map(move |signs| (axes, signs))) {
            let signs = [0, 1, 2].map(|c| if signs >> c & 1 == 1 { -1.0 } else { 1.0 });
            for order in 0..8 {
                let [rows, columns, transposed] = [0, 1, 2].map(|k| order >> k & 1 == 1);
                if !transposed || grid.h == grid.w {
                    mistakes.push(Mistake { factor, axes, signs, rows, columns, transposed });
                }
            }
        }
    }
    // A symmetric start looks alike in several ways: the simplest one is named.
    mistakes.sort_by_key(Mistake::parts);
    let origin = format!("{name}, {}", sequence.name);
    let expected = "the start of the recorded trajectory";
    match mistakes.iter().find(|mistake| apart(mistake) <= SAME) {
        Some(mistake) => Err(Error::invalid(origin, "frame 0", expected, mistake.describe())),
        None => {
            let centimetres = 100.0 * now * sequence.side_m();
            tracing::warn!(
                "{origin}: frame 0 is on average {centimetres:.1} cm away from the start of the recorded trajectory"
            );
            Ok(())
        }
    }
}
