//! The energy of a cloth at a trial acceleration (paper section 3.2).

use super::vector::{angle, at, dot, length};
use super::{Factors, Trial};
use crate::cpu::Real;
use crate::sim::{EnergyTerms, Grid};
use rayon::prelude::*;

/// The five terms of the energy of one cloth, summed in double precision row by row.
pub fn energy<T: Real>(trial: &Trial<'_, T>) -> EnergyTerms {
    let rows: Vec<EnergyTerms> = (0..trial.grid.h).into_par_iter().map(|i| row(trial, i)).collect();
    let sum = |term: fn(&EnergyTerms) -> f64| rows.iter().map(term).sum();
    EnergyTerms {
        stretch: sum(|r| r.stretch),
        shear: sum(|r| r.shear),
        bend: sum(|r| r.bend),
        inertia: sum(|r| r.inertia),
        external: sum(|r| r.external),
    }
}

/// What row `i` of particles and row `i` of cells contribute.
fn row<T: Real>(trial: &Trial<'_, T>, i: usize) -> EnergyTerms {
    let Grid { h, w } = trial.grid;
    let n = h * w;
    let Factors { vertical, horizontal, shear, bend } = trial.factors();
    let square = |v: T| v.f64() * v.f64();
    let right_angle = T::of(std::f64::consts::FRAC_PI_2);
    let mut sum = EnergyTerms::default();
    for j in 0..w {
        if i + 1 < h {
            let e = trial.vertical(i, j);
            sum.stretch += vertical.f64() * square(length(e) - T::one());
            if i + 2 < h {
                sum.bend += bend.f64() * square(angle(trial.vertical(i + 1, j), e));
            }
        }
        if j + 1 < w {
            let e = trial.horizontal(i, j);
            sum.stretch += horizontal.f64() * square(length(e) - T::one());
            if j + 2 < w {
                sum.bend += bend.f64() * square(angle(trial.horizontal(i, j + 1), e));
            }
        }
        if i + 1 < h && j + 1 < w {
            for u in [trial.vertical(i, j), trial.vertical(i, j + 1)] {
                for v in [trial.horizontal(i, j), trial.horizontal(i + 1, j)] {
                    sum.shear += shear.f64() * square(angle(u, v) - right_angle);
                }
            }
        }
        let mass = trial.grid.mass(i, j) / n as f64;
        let (a, f) = (at(trial.a, n, i * w + j), at(trial.f, n, i * w + j));
        sum.inertia += 0.5 * mass * dot(a, a).f64();
        sum.external -= mass * dot(a, f).f64();
    }
    sum
}
