//! The sparse Hessian of a frame's energy and its Cholesky factors: a Newton step.

use super::cloth::{Block, Projection, Trial, hessian};
use crate::cpu::optim::InverseHessian;
use crate::sim::Grid;
use crate::{Error, Result};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};

/// Particles that come after a particle in the grid and share a term with it: rows and columns from there.
const NEIGHBOURS: [(usize, isize); 6] = [(0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];

/// The share of the negative curvature that is left out at first: less is rarely enough far from the minimum, and to find that
/// out costs as much as factors that are of use.
const FIRST: Projection = Projection(0.25);
/// The least share that is left out where all of it is too much.
const LEAST: f64 = 1.0 / 64.0;
/// By how much the share grows when it was not enough, and shrinks after it was.
const STEP: f64 = 8.0;
const EASE: f64 = 2.0;

/// Columns that are factored together though some of them have zeros there: up to how many, and up to which share of zeros.
/// Three unknowns to a particle want more together than faer's default; measured on 100x100.
const RELAX: &[(usize, f64)] = &[(12, 1.0), (24, 0.8), (64, 0.1), (usize::MAX, 0.05)];

/// The least pivot of a definite matrix, beside its largest element.
const ROUNDING: f32 = 1e-6;

/// The inverse Hessian of a cloth at a trial, by its Cholesky factors in single precision: a step is measured on the energy
/// itself, and what rounding adds to one is undone by the next.
///
/// The unknowns are the particles, component by component; the lower triangle of the Hessian has a fixed pattern, so that
/// its symbolic factorisation and all memory are made once.
pub struct FactoredHessian {
    grid: Grid,
    pattern: SymbolicSparseColMat<usize>,
    symbolic: SymbolicCholesky<usize>,
    values: Vec<f32>,
    /// Of the last trial that was factored.
    factors: Vec<f32>,
    workspace: MemBuffer,
    interleaved: Vec<f32>,
    /// What was needed last, eased.
    projection: Projection,
    /// Of each particle, which of its neighbours there are: place in the column, after its own entries.
    places: Vec<[Option<usize>; NEIGHBOURS.len()]>,
}

impl FactoredHessian {
    /// Analyses the pattern of a grid; an error when memory does not suffice.
    pub fn new(grid: Grid) -> Result<Self> {
        let n = grid.particles();
        let mut places = vec![[None; NEIGHBOURS.len()]; n];
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for (p, places) in places.iter_mut().enumerate() {
            let mut others = Vec::new();
            for (place, &(down, across)) in places.iter_mut().zip(&NEIGHBOURS) {
                let (i, j) = (p / grid.w + down, (p % grid.w).checked_add_signed(across));
                if let Some(j) = j.filter(|&j| j < grid.w && i < grid.h) {
                    *place = Some(others.len());
                    others.push(i * grid.w + j);
                }
            }
            for component in 0..3 {
                rows.extend((component..3).map(|c| 3 * p + c));
                rows.extend(others.iter().flat_map(|q| (0..3).map(move |c| 3 * q + c)));
                starts.push(rows.len());
            }
        }
        let values = vec![0.0; rows.len()];
        let pattern = SymbolicSparseColMat::new_checked(3 * n, 3 * n, starts, None, rows);
        let supernodal_params = SymbolicSupernodalParams { relax: Some(RELAX) };
        let params = CholeskySymbolicParams { supernodal_params, ..Default::default() };
        let order = SymmetricOrdering::Amd;
        let symbolic =
            factorize_symbolic_cholesky(pattern.as_ref(), Side::Lower, order, params).map_err(unsolved)?;
        let mut factors = Vec::new();
        factors.try_reserve_exact(symbolic.len_val()).map_err(unsolved)?;
        factors.resize(symbolic.len_val(), 0.0);
        let workspace = StackReq::or(
            symbolic.factorize_numeric_llt_scratch::<f32>(Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f32>(1, Par::Seq),
        );
        Ok(Self {
            grid,
            pattern,
            symbolic,
            values,
            factors,
            workspace: MemBuffer::try_new(workspace).map_err(unsolved)?,
            interleaved: vec![0.0; 3 * n],
            projection: FIRST,
            places,
        })
    }

    /// Forgets how much of the negative curvature had to be left out.
    pub fn reset(&mut self) {
        self.projection = FIRST;
    }

    /// Factors the Hessian at a trial with as little of its negative curvature left out as makes it positive definite.
    ///
    /// A full projection is always definite, and converges slowly: of a folded sheet much is compressed, and the projection
    /// is far stiffer there than the cloth.
    pub fn factor(&mut self, trial: &Trial<'_, f64>) -> Result<()> {
        loop {
            self.assemble(trial, self.projection);
            let matrix = SparseColMatRef::new(self.pattern.as_ref(), &self.values);
            let Projection(share) = self.projection;
            // Without its negative curvature a matrix is definite, and a pivot that is not is so by rounding alone.
            let largest = self.values.iter().fold(0.0, |most: f32, v| most.max(v.abs()));
            let regularization = match share < 1.0 {
                true => LltRegularization::default(),
                false => LltRegularization {
                    dynamic_regularization_delta: ROUNDING * largest,
                    dynamic_regularization_epsilon: ROUNDING * largest,
                },
            };
            let factored = self.symbolic.factorize_numeric_llt(
                &mut self.factors,
                matrix,
                Side::Lower,
                regularization,
                Par::Seq,
                MemStack::new(&mut self.workspace),
                Default::default(),
            );
            match factored {
                Ok(_) => {
                    self.projection = Projection(if share > LEAST { share / EASE } else { 0.0 });
                    return Ok(());
                }
                Err(_) if share < 1.0 => self.projection = Projection((share * STEP).clamp(LEAST, 1.0)),
                Err(e) => return Err(unsolved(e)),
            }
        }
    }

    /// Fills the lower triangle; a handle's rows and columns are those of the unit matrix.
    fn assemble(&mut self, trial: &Trial<'_, f64>, projection: Projection) {
        let (grid, n) = (self.grid, self.grid.particles());
        let Self { pattern, values, places, .. } = self;
        let starts = pattern.col_ptr();
        values.fill(0.0);
        let free = |p: usize| trial.slots[p] == 0;
        // How far on in the grid: no two are the same where rows have more than three particles.
        let ahead = NEIGHBOURS.map(|(down, across)| (down * grid.w).wrapping_add_signed(across));
        let mut add = |p: usize, q: usize, block: &Block| {
            if p < q || !free(p) || !free(q) {
                return;
            }
            // Of column q: rows from q's own component down, then those of its neighbours.
            let place = (p != q).then(|| {
                let kind = ahead.iter().position(|&ahead| ahead == p - q);
                kind.and_then(|kind| places[q][kind]).expect("particles of a term are neighbours")
            });
            for (column, &start) in starts[3 * q..3 * q + 3].iter().enumerate() {
                match place {
                    None => {
                        (column..3).for_each(|row| values[start + row - column] += block[row][column] as f32)
                    }
                    Some(place) => {
                        let first = start + 3 - column + 3 * place;
                        (0..3).for_each(|row| values[first + row] += block[row][column] as f32);
                    }
                }
            }
        };
        hessian(trial, projection, &mut add);
        for p in 0..n {
            let own = if free(p) { grid.mass(p / grid.w, p % grid.w) / n as f64 } else { 1.0 };
            (0..3).for_each(|c| values[starts[3 * p + c]] += own as f32);
        }
    }
}

impl InverseHessian<f64> for FactoredHessian {
    fn apply(&mut self, direction: &mut [f64]) {
        let n = self.grid.particles();
        self.interleaved.iter_mut().enumerate().for_each(|(k, to)| *to = direction[k % 3 * n + k / 3] as f32);
        LltRef::new(&self.symbolic, &self.factors).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(&mut self.interleaved, 3 * n, 1),
            Par::Seq,
            MemStack::new(&mut self.workspace),
        );
        direction.iter_mut().enumerate().for_each(|(k, to)| *to = self.interleaved[k % n * 3 + k / n].into());
    }
}

fn unsolved(e: impl std::fmt::Debug) -> Error {
    Error::Device(format!("cpu: the Hessian cannot be factored: {e:?}"))
}
