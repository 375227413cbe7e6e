//! The settled start: the drape that hangs still from two corners, for the cloth of its scene.

use super::Units;
use super::setup::warn_once;
use super::surface::Sheet;
use crate::cloth::{Air, Cloth, Grid, Model};
use crate::cpu::{Equilibrium, equilibrium};
use crate::scene::{Placement, UpAxis};
use crate::{Error, Result};
use std::sync::{Arc, Mutex, PoisonError};

/// Particles of the grid on which it begins, and of the finest on which the equilibrium is computed, in a few
/// seconds.
const COARSE: usize = 40 * 40;
const FINEST: usize = 128 * 128;
/// Number of drapes that a process remembers: as many as the grids and materials that it is likely to return to.
const REMEMBERED: usize = 16;

/// A drape that was computed before.
struct Drape {
    grid: Grid,
    cloth: Cloth,
    points: Arc<Vec<[f64; 3]>>,
}

/// The drapes computed last.
static DRAPES: Mutex<Vec<Drape>> = Mutex::new(Vec::new());

/// Returns the equilibrium of a cloth that hangs from its corners (H-1, 0) and (0, 0), 0.9 of its side apart, in still
/// air: the positions of the particles \[edges\], z up. Where it is held in the scene does not matter.
///
/// It starts from a stored drape on a coarse grid, and lets the same sheet come to rest on finer and finer ones. On
/// grids finer than 128x128, or where memory runs out, the drape of a coarser one is resampled. `origin` names
/// the scene in warnings.
pub(super) fn settled(grid: Grid, units: &Units, cloth: &Cloth, origin: &str) -> Result<Arc<Vec<[f64; 3]>>> {
    let cloth = Cloth {
        self_contact: None,
        air: Air::default(),
        handles: Placement::Corners.particles(grid),
        bodies: Vec::new(),
        ..cloth.clone()
    };
    // Not held while the drape is computed: the threads that compute it may be in need of another.
    let drapes = || DRAPES.lock().unwrap_or_else(PoisonError::into_inner);
    let known = drapes()
        .iter()
        .find(|drape| drape.grid == grid && drape.cloth == cloth)
        .map(|drape| drape.points.clone());
    if let Some(known) = known {
        return Ok(known);
    }
    let mut sheet = Sheet::settled(coarsest(grid))?;
    let height = (grid.h - 1) as f64;
    // Stored for a height of 1 m, which is H - 1 edges of the scene's grid.
    sheet.points.iter_mut().for_each(|p| *p = UpAxis::Y.to_z_up(*p).map(|c| c * height));
    let mut still = true;
    for level in levels(grid) {
        sheet = sheet.regrid(level);
        let finer = height / (level.h - 1) as f64;
        let reached = match at_rest(&sheet, (grid, units), &cloth, finer) {
            // Not enough memory for the factors.
            Err(Error::Device(_)) => break,
            reached => reached?,
        };
        sheet.points = points(&reached.x, finer);
        still = reached.is_still();
    }
    if !still {
        warn_once(format!(
            "{origin}: start: no drape at rest was found for this cloth; it begins to move at once"
        ));
    }
    let points = Arc::new(sheet.regrid(grid).points);
    let mut drapes = drapes();
    if drapes.len() == REMEMBERED {
        drapes.remove(0);
    }
    drapes.push(Drape { grid, cloth, points: points.clone() });
    Ok(points)
}

/// Returns the grids on which the drape comes to rest, the finest last.
fn levels(grid: Grid) -> Vec<Grid> {
    let half = |of: &Grid| {
        let coarser = Grid { h: of.h.div_ceil(2), w: of.w.div_ceil(2) };
        (of.particles() > COARSE && coarser.h.min(coarser.w) >= 8).then_some(coarser)
    };
    let mut levels: Vec<Grid> = std::iter::successors(Some(grid), half).collect();
    levels.reverse();
    let coarsest = levels[0];
    levels.retain(|level| *level == coarsest || level.particles() <= FINEST);
    levels
}

fn coarsest(grid: Grid) -> Grid {
    levels(grid)[0]
}

/// Lets a sheet on a coarser grid come to rest, whose points are in edges of the scene's grid, of which an edge of its
/// own has `finer`. The cloth is that of the scene's grid.
fn at_rest(sheet: &Sheet, (grid, units): (Grid, &Units), cloth: &Cloth, finer: f64) -> Result<Equilibrium> {
    let own = Units { length_m: units.length_m * finer, ..*units };
    let own_cloth = Cloth {
        material: own.material(sheet.grid, units.moduli(grid, cloth.material)),
        gravity: cloth.gravity.map(|g| g / finer),
        repulsion: cloth.repulsion.map(|mut repulsion| {
            repulsion.strength /= finer * finer;
            repulsion
        }),
        self_contact: None,
        air: Air::default(),
        handles: Placement::Corners.particles(sheet.grid),
        bodies: Vec::new(),
        ..Cloth::default()
    };
    let x: Vec<f64> = (0..3).flat_map(|c| sheet.points.iter().map(move |p| p[c] / finer)).collect();
    equilibrium(&Model { grid: sheet.grid, cloths: vec![own_cloth] }, &x)
}

/// Returns the points of a field [3, H, W], `finer` times as large.
fn points(x: &[f64], finer: f64) -> Vec<[f64; 3]> {
    let n = x.len() / 3;
    (0..n).map(|p| [x[p], x[n + p], x[2 * n + p]].map(|c| c * finer)).collect()
}
