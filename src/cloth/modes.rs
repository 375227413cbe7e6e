//! The modes of a flat sheet: how stiff a small cosine wave is, and what forces at the handles do to all of them.
//!
//! A cosine transform (DCT-II, orthonormal) along both axes makes the Hessian of a flat sheet's energy nearly diagonal
//! (after Liu, Bouaziz and Kavan 2017). Both devices precondition with it.

use super::{Cloth, Grid, Model};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Share of the tangential stiffness that a mode of the sheet has along its other axis, and across its surface: a
/// sheet under tension resists there, too.
pub const TENSION: f64 = 3e-4;

/// Most handles of a cloth that react to steps ([`Reactions`]).
pub const MAX_REACTIONS: usize = 8;

/// What the inverse Hessians of a sheet in motion take from a flat one, as multiples of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SheetConstants {
    /// Inertia of a mode along the sheet's surface.
    pub tangential_inertia: f64,
    /// Share of what contacts with bodies add to that inertia, as if all particles had them.
    pub tangential_contact: f64,
    /// Inertia of a mode across the sheet's surface.
    pub normal_inertia: f64,
    /// Resistance to bending of a mode across the sheet's surface.
    pub normal_bend: f64,
}

impl SheetConstants {
    /// Those of a flat sheet.
    pub const FLAT: Self =
        Self { tangential_inertia: 1.0, tangential_contact: 0.0, normal_inertia: 1.0, normal_bend: 1.0 };
    /// Those of a sheet in motion, found together with [`HANDLE_SHARE`](crate::settings::HANDLE_SHARE). Bodies hold a sheet by
    /// friction: the share of contacts leaves half the gap of one that lies on a ball. (All of it leaves a little less there, and more
    /// where few particles touch.)
    pub const FITTED: Self =
        Self { tangential_inertia: 2.0, tangential_contact: 0.25, normal_inertia: 4.0, normal_bend: 4.0 };
}

/// The fields of a sheet with an inverse Hessian of their own: a component in the axes of the world, those along the sheet's two
/// tangents, and that along its normal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// Any component in the axes of the world.
    Space,
    /// Along t_1, the direction in which i grows.
    FirstTangent,
    /// Along t_2, the direction in which j grows.
    SecondTangent,
    /// Across the surface.
    Normal,
}

impl Component {
    /// All of them, in order.
    pub const ALL: [Self; 4] = [Self::Space, Self::FirstTangent, Self::SecondTangent, Self::Normal];

    /// Returns the eigenvalue of mode (k, l) of this component: inertia, stretch, bend and shear of a small wave on the sheet at
    /// rest, and in the axes of the world its contacts with bodies, as if all particles had them.
    pub fn eigenvalue(
        self,
        grid: Grid,
        (cloth, constants): (&Cloth, &SheetConstants),
        (k, l): (usize, usize),
    ) -> f64 {
        let (Grid { h, w }, material) = (grid, cloth.material);
        let (m, q, n) = (mu(h, k), mu(w, l), (h * w) as f64);
        let damped = material.stretches().map(|coefficient| 2.0 * (1.0 + cloth.damping) * coefficient);
        let (along_h, along_w) = (damped[0] / ((h - 1) * w) as f64, damped[1] / (h * (w - 1)) as f64);
        let [down, across] = material.bends().map(|coefficient| 2.0 * coefficient);
        let tangential = |along: f64, own: f64, other: f64, bend: f64| {
            let inertia =
                constants.tangential_inertia + constants.tangential_contact * cloth.contact_curvature();
            let others = inertia + 8.0 * material.shear * other + bend * other * other;
            along * (own + TENSION * other) + others / n
        };
        let bend = down * m * m + across * q * q;
        let stretch = along_h * m + along_w * q;
        match self {
            Self::Space => {
                let inertia = 1.0 + cloth.contact_curvature();
                stretch + (inertia + bend + 4.0 * material.shear * (m + q)) / n
            }
            Self::FirstTangent => tangential(along_h, m, q, across),
            Self::SecondTangent => tangential(along_w, q, m, down),
            Self::Normal => {
                let inertia = constants.normal_inertia + 2.0 * TENSION * material.stretch;
                TENSION * stretch + (inertia + constants.normal_bend * bend) / n
            }
        }
    }
}

/// Returns the element in row k, column i of the orthonormal DCT-II of n points.
pub fn cosine(n: usize, k: usize, i: usize) -> f64 {
    let scale = if k == 0 { 1.0 } else { 2.0 };
    // Reducing the argument exactly keeps long transforms accurate to the last bit.
    let angle = PI * (k * (2 * i + 1) % (4 * n)) as f64 / (2 * n) as f64;
    (scale / n as f64).sqrt() * angle.cos()
}

/// Returns the eigenvalue of mode k of second differences along n points, `2 - 2 cos(pi k / n)`.
pub fn mu(n: usize, k: usize) -> f64 {
    // Without the cancellation in 1 - cos.
    4.0 * (PI * k as f64 / (2 * n) as f64).sin().powi(2)
}

/// The reactions of handles to a step. The modes of a sheet don't know that its handles stay where they are: their inverse Hessian
/// M moves them. Forces at the handles that take this back make it exact there,
/// `(M - M E (E^T M E)^-1 E^T M) g` with the columns of E being 1 at one handle each, so a step y = M g becomes
/// `y - sum_k field_k y(handle_k)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Reactions {
    /// The handles that take part.
    pub handles: Vec<usize>,
    /// `M E (E^T M E)^-1` for each handle and each [`Component`], shape [K, 4, H W].
    pub fields: Vec<f64>,
}

impl Reactions {
    /// Returns the largest number of handles that react in one of these cloths, at least 1.
    pub fn most(model: &Model) -> usize {
        let most = model.cloths.iter().map(|cloth| reacting(cloth.handles.len())).max();
        most.unwrap_or(0).max(1)
    }

    /// Computes the reactions of a cloth's handles. Of more than [`MAX_REACTIONS`], the first and the middle one react.
    pub fn new(grid: Grid, cloth: &Cloth, constants: &SheetConstants) -> Self {
        let n = grid.particles();
        let count = reacting(cloth.handles.len());
        let handles: Vec<usize> =
            (0..count).map(|k| cloth.handles[k * cloth.handles.len() / count]).collect();
        let mut fields = vec![0.0; count * 4 * n];
        if count > 0 {
            let tables = [grid.h, grid.w].map(table);
            let responses: Vec<Vec<f64>> = Component::ALL
                .into_par_iter()
                .map(|component| {
                    let of = (cloth, constants);
                    let inverse: Vec<f64> = (0..n)
                        .map(|at| component.eigenvalue(grid, of, (at / grid.w, at % grid.w)).recip())
                        .collect();
                    let each = handles.iter().flat_map(|&p| response(grid, &tables, &inverse, p));
                    weighted(n, &handles, each.collect())
                })
                .collect();
            for (component, responses) in responses.iter().enumerate() {
                for (k, response) in responses.chunks_exact(n).enumerate() {
                    fields[(4 * k + component) * n..][..n].copy_from_slice(response);
                }
            }
        }
        Self { handles, fields }
    }
}

/// Returns how many of a cloth's handles react. When eight of a long row did, whose neighbours did not, layers passed through each other in the
/// scene `twist` at 64x64.
fn reacting(handles: usize) -> usize {
    if handles > MAX_REACTIONS { 2 } else { handles }
}

/// Returns the orthonormal DCT-II of n points, row by row.
fn table(n: usize) -> Vec<f64> {
    (0..n * n).map(|at| cosine(n, at / n, at % n)).collect()
}

/// Returns what a unit force at particle `p` does [H W], given one over the eigenvalue of each mode.
fn response(Grid { h, w }: Grid, [rows, columns]: &[Vec<f64>; 2], inverse: &[f64], p: usize) -> Vec<f64> {
    let (i, j) = (p / w, p % w);
    let mut along = vec![0.0; h * w];
    for (k, along) in along.chunks_exact_mut(w).enumerate() {
        for l in 0..w {
            let mode = inverse[k * w + l] * rows[k * h + i] * columns[l * w + j];
            let row = &columns[l * w..][..w];
            along.iter_mut().zip(row).for_each(|(to, cosine)| *to += mode * cosine);
        }
    }
    let mut field = vec![0.0; h * w];
    for (k, along) in along.chunks_exact(w).enumerate() {
        for (i, to) in field.chunks_exact_mut(w).enumerate() {
            let cosine = rows[k * h + i];
            to.iter_mut().zip(along).for_each(|(to, along)| *to += cosine * along);
        }
    }
    field
}

/// Multiplies the responses R [K, n] of forces at the handles, as columns, by the inverse of R at the handles.
fn weighted(n: usize, handles: &[usize], responses: Vec<f64>) -> Vec<f64> {
    let count = handles.len();
    // Gauss-Jordan elimination of a positive definite matrix, which needs no pivots, applied to all columns at once.
    let mut at_handles: Vec<Vec<f64>> =
        responses.chunks_exact(n).map(|response| handles.iter().map(|&p| response[p]).collect()).collect();
    let mut fields: Vec<Vec<f64>> = responses.chunks_exact(n).map(<[f64]>::to_vec).collect();
    for k in 0..count {
        let share = at_handles[k][k].recip();
        at_handles[k].iter_mut().chain(&mut fields[k]).for_each(|v| *v *= share);
        let (pivot, field) = (at_handles[k].clone(), fields[k].clone());
        for other in (0..count).filter(|&other| other != k) {
            let factor = at_handles[other][k];
            at_handles[other].iter_mut().zip(&pivot).for_each(|(v, pivot)| *v -= factor * pivot);
            fields[other].iter_mut().zip(&field).for_each(|(v, field)| *v -= factor * field);
        }
    }
    fields.concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With reactions a step does nothing at the handles, and what it does elsewhere answers all forces but theirs.
    #[test]
    fn reactions_keep_handles_in_place() {
        let grid = Grid { h: 11, w: 14 };
        let n = grid.particles();
        let cloth = Cloth { handles: vec![0, 13, 75, 76], ..Cloth::default() };
        let reactions = Reactions::new(grid, &cloth, &SheetConstants::FITTED);
        assert_eq!(reactions.handles, cloth.handles);
        let tables = [grid.h, grid.w].map(table);
        let force: Vec<f64> = (0..n).map(|p| ((p * p + 3) % 17) as f64 - 8.0).collect();
        for (c, component) in Component::ALL.into_iter().enumerate() {
            let lambda: Vec<f64> = (0..n)
                .map(|at| {
                    component.eigenvalue(grid, (&cloth, &SheetConstants::FITTED), (at / grid.w, at % grid.w))
                })
                .collect();
            let inverse: Vec<f64> = lambda.iter().map(|lambda| lambda.recip()).collect();
            let apply = |field: &[f64], by: &[f64]| {
                let mut sum = vec![0.0; n];
                for (p, &value) in field.iter().enumerate() {
                    let one = response(grid, &tables, by, p);
                    sum.iter_mut().zip(one).for_each(|(sum, v)| *sum += value * v);
                }
                sum
            };
            let mut step = apply(&force, &inverse);
            let moved: Vec<f64> = reactions.handles.iter().map(|&p| step[p]).collect();
            for (k, moved) in moved.iter().enumerate() {
                let field = &reactions.fields[(4 * k + c) * n..][..n];
                step.iter_mut().zip(field).for_each(|(step, field)| *step -= moved * field);
            }
            let largest = step.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
            let back = apply(&step, &lambda);
            for p in 0..n {
                if cloth.handles.contains(&p) {
                    assert!(step[p].abs() < 1e-10 * largest, "{component:?} moves handle {p} by {}", step[p]);
                } else {
                    assert!((back[p] - force[p]).abs() < 1e-7, "{component:?}, particle {p}: {}", back[p]);
                }
            }
        }
    }

    /// Of many handles, two take part.
    #[test]
    fn two_of_many_handles_react() {
        let grid = Grid { h: 9, w: 32 };
        let cloth = Cloth { handles: (0..32).collect(), ..Cloth::default() };
        let reactions = Reactions::new(grid, &cloth, &SheetConstants::FITTED);
        assert_eq!(reactions.handles, [0, 16]);
        assert!(Reactions::new(grid, &Cloth::default(), &SheetConstants::FITTED).fields.is_empty());
    }
}
