//! The two tests by which textile laboratories measure how a fabric drapes, made with a simulated one: Cusick's drape
//! coefficient and the bending length of a cantilever.
//!
//! Both cloths come to rest in [`equilibrium`], from the same start every time, so the results are the same on every run of a
//! machine. They pass through themselves: folds that would lie on each other overlap in the shadow.

use crate::cloth::{Cloth, Grid, Mask, Model, State};
use crate::cpu::equilibrium;
use crate::scene::{Moduli, Units};
use crate::statistics::mean_and_deviation;
use crate::{Error, Result};
use std::f64::consts::PI;

/// Gravity of both tests [m/s^2].
pub const GRAVITY_M_S2: f64 = 9.81;

/// Radii of Cusick's specimen and of the discs that hold it \[m\] (G. E. Cusick, The Measurement of Fabric Drape, J. Text.
/// Inst. 59(6), 253, 1968; BS 5058, ISO 9073-9).
pub const SPECIMEN_M: f64 = 0.15;
/// See [`SPECIMEN_M`].
pub const SUPPORT_M: f64 = 0.09;

/// Angle between the plane of a cantilever and the chord from its edge to its end (BS 3356, ISO 9073-7).
const CHORD: f64 = 41.5 * PI / 180.0;
/// Acceleration [edges / frame^2] of gravity, as in a sheet of 1 m on 32x32 particles at 1/60 s: it decides the duration of a
/// frame, on which an equilibrium does not depend.
const OWN_GRAVITY: f64 = 0.085;
/// Samples of the shadow along the diameter of the specimen.
const SAMPLES: f64 = 1500.0;
/// Fewest cells along that diameter: three of them lie between support and edge.
const COARSEST: usize = 16;
/// Range of overhangs in which the one with [`CHORD`] is searched, in bending lengths, and its precision.
const OVERHANGS: [f64; 2] = [1.0, 4.0];
const PRECISION: f64 = 1e-4;

/// The result of Cusick's test.
#[derive(Clone, Debug, PartialEq)]
pub struct Drape {
    /// (area of the shadow - area of the support) / (area of the specimen - area of the support) of each draping: 1 for a
    /// plate, less for a cloth that falls into folds.
    pub coefficients: Vec<f64>,
    /// Area of the specimen \[m^2\], which consists of whole cells of the grid.
    pub specimen_m2: f64,
    /// Whether it came to rest every time. If not, the numbers are those of the shapes that it reached.
    pub is_still: bool,
}

impl Drape {
    /// Returns the drape coefficient, the mean over the drapings, and its standard deviation over them.
    pub fn coefficient(&self) -> (f64, f64) {
        mean_and_deviation(&self.coefficients)
    }
}

/// The result of the cantilever test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cantilever {
    /// Overhang \[m\] at which the chord is 41.5 degrees below the horizontal.
    pub overhang_m: f64,
    /// Bending length \[m\], half of the overhang.
    pub bending_length_m: f64,
    /// Whether the strips came to rest.
    pub is_still: bool,
}

/// Returns the cloth of a sheet with these moduli, without handles, on a grid with the edge `length_m`.
fn cloth(grid: Grid, (moduli, areal_mass_kg_m2): (Moduli, f64), length_m: f64) -> Cloth {
    let frame_time_s = (OWN_GRAVITY * length_m / GRAVITY_M_S2).sqrt();
    let units = Units { length_m, frame_time_s, areal_mass_kg_m2 };
    Cloth {
        material: units.material(grid, moduli),
        gravity: units.acceleration([0.0, 0.0, -GRAVITY_M_S2]),
        ..Cloth::default()
    }
}

/// Fails unless the moduli and the mass are those of a cloth that bends.
fn check(moduli: Moduli, areal_mass_kg_m2: f64) -> Result<()> {
    let numbers = [
        ("stretch_modulus", moduli.stretch_modulus),
        ("shear_modulus", moduli.shear_modulus),
        ("bending_stiffness", moduli.bending_stiffness),
        ("areal_mass_kg_m2", areal_mass_kg_m2),
    ];
    match numbers.into_iter().find(|(_, number)| !(number.is_finite() && *number > 0.0)) {
        Some((field, number)) => Err(Error::invalid("drape", field, "a finite number above 0", number)),
        None => Ok(()),
    }
}

/// Measures the drape coefficient of a cloth with these moduli and this mass per area [kg/m^2] on a specimen with
/// `diameter` cells of the grid along its diameter, which is draped `times` times.
///
/// The particles above the support are held, as the discs of the real apparatus hold them. A flat specimen that is exactly
/// symmetric would not know where to fold, so it begins with waves of about a thousandth of a cell, from 2 to 12 along its
/// edge, with other phases each time. As a real one, it falls into one of several numbers of folds.
///
/// Fails as [`equilibrium`] does, if a number is not above 0, or if the grid is too coarse or too fine ([`Grid::new`]).
pub fn drape(moduli: Moduli, areal_mass_kg_m2: f64, diameter: usize, times: usize) -> Result<Drape> {
    check(moduli, areal_mass_kg_m2)?;
    if diameter < COARSEST {
        let expected = format!("{COARSEST} cells along the diameter, or more");
        return Err(Error::invalid("drape", "grid", expected, diameter));
    }
    if times == 0 {
        return Err(Error::invalid("drape", "drapings", "1 or more", times));
    }
    // A particle more on every side, so that cells that the circle cuts have their corners.
    let side = diameter.saturating_add(3);
    let grid = Grid::new(side, side, "drape")?;
    let length_m = 2.0 * SPECIMEN_M / diameter as f64;
    let middle = (side - 1) as f64 / 2.0;
    // Cells whose centres lie in the circle: they have its area to about a per cent.
    let mut wanted = vec![false; grid.particles()];
    for (i, j) in (0..side - 1).flat_map(|i| (0..side - 1).map(move |j| (i, j))) {
        let [y, x] = [i, j].map(|k| k as f64 + 0.5 - middle);
        if y.hypot(x) * length_m <= SPECIMEN_M {
            let p = i * side + j;
            [p, p + 1, p + side, p + side + 1].into_iter().for_each(|p| wanted[p] = true);
        }
    }
    let place = |p: usize| [(p / side) as f64 - middle, (p % side) as f64 - middle];
    // Distance from the support, 0 above it.
    let outside = |p: usize| (place(p)[0].hypot(place(p)[1]) * length_m - SUPPORT_M).max(0.0);
    let cloth = Cloth {
        handles: (0..grid.particles()).filter(|&p| outside(p) == 0.0).collect(),
        mask: Some(Mask::new(grid, &wanted, "drape")?),
        ..cloth(grid, (moduli, areal_mass_kg_m2), length_m)
    };
    let (n, faces) = (grid.particles(), cloth.faces(grid));
    let specimen_m2 = faces.len() as f64 / 2.0 * length_m * length_m;
    let support_m2 = PI * SUPPORT_M * SUPPORT_M;
    let model = Model { grid, cloths: vec![cloth] };
    let (mut coefficients, mut is_still) = (Vec::new(), true);
    for time in 1..=times {
        let mut x = State::<f64>::rest(grid, 1).x;
        for p in 0..n {
            let [y, z] = place(p);
            let wave = |k: f64| (k * y.atan2(z) + time as f64 * k * k).cos();
            let waves: f64 = (2..=12).map(|k| wave(f64::from(k))).sum();
            x[2 * n + p] = 1e-3 * waves * outside(p) / SPECIMEN_M;
        }
        let found = equilibrium(&model, &x)?;
        let at = |p: u32| [0, 1].map(|c| found.x[c * n + p as usize] * length_m);
        let triangles: Vec<_> = faces.iter().map(|face| face.map(at)).collect();
        let shadow_m2 = shadow(&triangles, 2.0 * SPECIMEN_M / SAMPLES);
        coefficients.push((shadow_m2 - support_m2) / (specimen_m2 - support_m2));
        is_still &= found.is_still();
    }
    Ok(Drape { coefficients, specimen_m2, is_still })
}

/// Returns the area of the union of triangles \[m^2\], given by the positions \[m\] of their corners; overlaps count once. It is
/// that of the squares of a grid, with the side `step` \[m\], whose centres lie in a triangle.
pub fn shadow(triangles: &[[[f64; 2]; 3]], step: f64) -> f64 {
    let corners = || triangles.iter().flatten();
    let low = [0, 1].map(|c| corners().fold(f64::INFINITY, |low, corner| low.min(corner[c])));
    let high = [0, 1].map(|c| corners().fold(f64::NEG_INFINITY, |high, corner| high.max(corner[c])));
    let [columns, rows] = [0, 1].map(|c| ((high[c] - low[c]) / step).ceil().max(0.0) as usize + 1);
    let mut covered = vec![false; columns * rows];
    for triangle in triangles {
        // In samples.
        let [a, b, c] = triangle.map(|corner| [0, 1].map(|k| (corner[k] - low[k]) / step));
        let span = |k: usize| {
            let (from, to) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
            (from - 0.5).ceil().max(0.0) as usize..=(to - 0.5).floor().max(0.0) as usize
        };
        let side = |p: [f64; 2], q: [f64; 2], at: [f64; 2]| {
            (q[0] - p[0]) * (at[1] - p[1]) - (q[1] - p[1]) * (at[0] - p[0])
        };
        for row in span(1) {
            for column in span(0) {
                let at = [column as f64 + 0.5, row as f64 + 0.5];
                let sides = [side(a, b, at), side(b, c, at), side(c, a, at)];
                if sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0) {
                    covered[row * columns + column] = true;
                }
            }
        }
    }
    covered.iter().filter(|covered| **covered).count() as f64 * step * step
}

/// Measures the bending length along the height (the warp) of a cloth with these moduli and this mass per area [kg/m^2] on a strip with `edges` edges along
/// its overhang: searches the overhang at which the chord from the edge of the platform to the end of the strip is
/// 41.5 degrees below the horizontal, and halves it.
///
/// Fails as [`equilibrium`] does, if a number is not above 0, or if the grid is too coarse or too fine ([`Grid::new`]).
pub fn cantilever(moduli: Moduli, areal_mass_kg_m2: f64, edges: usize) -> Result<Cantilever> {
    check(moduli, areal_mass_kg_m2)?;
    // Two rows are held, which clamps the strip half an edge after the first of them.
    // The strip is as wide as it is long: a grid's one bending coefficient belongs to the mean of its directions.
    let side = edges.saturating_add(2);
    let grid = Grid::new(side, side, "cantilever")?;
    let (n, w) = (grid.particles(), grid.w);
    let free = edges as f64 + 0.5;
    let mut x = State::<f64>::rest(grid, 1).x;
    let mut is_still = true;
    let mut angle = |overhang_m: f64| -> Result<f64> {
        let strip = cloth(grid, (moduli, areal_mass_kg_m2), overhang_m / free);
        let strip = Cloth { handles: (0..2 * w).collect(), ..strip };
        let found = equilibrium(&Model { grid, cloths: vec![strip] }, &x)?;
        is_still &= found.is_still();
        // The next strip is another one of about the same shape.
        x = found.x;
        let middle = |row: usize, c: usize| (0..w).map(|j| x[c * n + row * w + j]).sum::<f64>() / w as f64;
        let clamp = |c: usize| (middle(0, c) + middle(1, c)) / 2.0;
        let [along, up] = [1, 2].map(|c| middle(grid.h - 1, c) - clamp(c));
        Ok((-up).atan2(along))
    };
    let [expected, _] = moduli.bending_lengths_m(areal_mass_kg_m2, GRAVITY_M_S2);
    let [mut short, mut long] = OVERHANGS.map(|lengths| lengths * expected);
    while long - short > PRECISION * short {
        let overhang_m = (short + long) / 2.0;
        match angle(overhang_m)? < CHORD {
            true => short = overhang_m,
            false => long = overhang_m,
        }
    }
    let overhang_m = (short + long) / 2.0;
    Ok(Cantilever { overhang_m, bending_length_m: overhang_m / 2.0, is_still })
}
