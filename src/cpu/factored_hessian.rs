//! Newton steps from the sparse Hessian of a frame's energy and its Cholesky factors.

use super::cloth::{AFTER, Hessian, Projection, Trial, add_own_block, neighbours};
use crate::cloth::Grid;
use crate::cpu::optim::InverseHessian;
use crate::{Error, Result, memory};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::sparse::linalg::SymbolicSupernodalParams;
use faer::sparse::linalg::amd;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};

/// The share of the negative curvature to remove at first. Less is rarely enough far from the minimum, and
/// finding that out costs as much as a successful factorisation.
const FIRST: Projection = Projection(0.25);
/// The smallest nonzero share to remove.
const LEAST: f64 = 1.0 / 64.0;
/// Factors by which the share grows after a failed factorisation (`STEP`) and shrinks after a successful one
/// (`EASE`).
const STEP: f64 = 8.0;
const EASE: f64 = 2.0;

/// Amalgamation of supernodes: up to how many columns, and up to which fraction of zeros. Three unknowns per
/// particle favour larger supernodes than faer's default; measured on 100x100.
const RELAX: &[(usize, f64)] = &[(12, 1.0), (24, 0.8), (64, 0.1), (usize::MAX, 0.05)];

/// Names the factors in out-of-memory errors.
const FACTORS: &str = "a Hessian's factors";

/// Smallest pivot of a definite matrix, relative to its largest element.
const ROUNDING: f32 = 1e-6;

/// The inverse Hessian of a cloth at a trial, by its Cholesky factors in single precision. That suffices: a
/// step is judged by the energy itself, and the next step undoes the rounding error of this one.
///
/// The unknowns are ordered by particle, three components each, and the particles by minimum degree, which
/// keeps the factors sparse. The pattern is the same at every trial, so the symbolic factorisation and all
/// memory are set up once.
pub struct FactoredHessian {
    grid: Grid,
    hessian: Hessian,
    /// Particles in the order of the unknowns.
    order: Vec<usize>,
    /// The pattern of the lower triangle, and the place of each of its numbers in the Hessian.
    pattern: SymbolicSparseColMat<usize>,
    sources: Vec<u32>,
    values: Vec<f32>,
    symbolic: SymbolicCholesky<usize>,
    /// Factors of the last trial.
    factors: Vec<f32>,
    workspace: MemBuffer,
    unknowns: Vec<f32>,
    /// The projection to try next: the last one that was needed, eased.
    projection: Projection,
}

impl FactoredHessian {
    /// Analyses the pattern of a grid. Fails if there is not enough memory.
    pub fn new(grid: Grid) -> Result<Self> {
        let n = grid.particles();
        let hessian = Hessian::new(grid)?;
        let (order, places) = minimum_degree(grid)?;
        let (mut starts, mut rows, mut sources) = (vec![0], Vec::new(), Vec::new());
        // Per component, on average: 2 numbers of its particle's own lower triangle, and 3 for each of the
        // particles after it.
        let most = 3 * n * (2 + 3 * AFTER);
        memory::reserve(&mut rows, most, FACTORS)?;
        memory::reserve(&mut sources, most, FACTORS)?;
        for (place, &q) in order.iter().enumerate() {
            let mut later: Vec<usize> = neighbours(grid, q).map(|p| places[p]).collect();
            later.retain(|&other| other > place);
            later.sort_unstable();
            for column in 0..3 {
                let own = (column..3).map(|row| (place, row));
                let others = later.iter().flat_map(|&other| (0..3).map(move |row| (other, row)));
                for (other, row) in own.chain(others) {
                    rows.push(3 * other + row);
                    let source = hessian.index_of((order[other], row), (q, column));
                    let source = source.expect("neighbours share a term");
                    sources.push(u32::try_from(source).expect("the largest grid has a billion numbers"));
                }
                starts.push(rows.len());
            }
        }
        let mut values = Vec::new();
        memory::reserve(&mut values, rows.len(), FACTORS)?;
        values.resize(rows.len(), 0.0);
        let pattern = SymbolicSparseColMat::new_checked(3 * n, 3 * n, starts, None, rows);
        let supernodal_params = SymbolicSupernodalParams { relax: Some(RELAX) };
        let params = CholeskySymbolicParams { supernodal_params, ..Default::default() };
        let symbolic = {
            // With the identity ordering faer analyses the upper triangle, but factors the lower one
            // unchanged.
            let upper = pattern.as_ref().transpose().to_col_major().map_err(unsolved)?;
            let ordering = SymmetricOrdering::Identity;
            factorize_symbolic_cholesky(upper.as_ref(), Side::Upper, ordering, params).map_err(unsolved)?
        };
        let mut factors = Vec::new();
        memory::reserve(&mut factors, symbolic.len_val(), FACTORS)?;
        factors.resize(symbolic.len_val(), 0.0);
        let workspace = StackReq::or(
            symbolic.factorize_numeric_llt_scratch::<f32>(Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f32>(1, Par::Seq),
        );
        Ok(Self {
            grid,
            hessian,
            order,
            pattern,
            sources,
            values,
            symbolic,
            factors,
            workspace: MemBuffer::try_new(workspace).map_err(unsolved)?,
            unknowns: vec![0.0; 3 * n],
            projection: FIRST,
        })
    }

    /// Resets the projection to its first value.
    pub fn reset(&mut self) {
        self.projection = FIRST;
    }

    /// Factors the Hessian at a trial, removing about as little of its negative curvature as makes it
    /// positive definite.
    ///
    /// Full projection always gives a definite matrix but converges slowly: much of a folded sheet is
    /// compressed, and there the projected Hessian is far stiffer than the cloth.
    pub fn factor(&mut self, trial: &Trial<'_, f64>) -> Result<()> {
        loop {
            self.assemble(trial, self.projection);
            let matrix = SparseColMatRef::new(self.pattern.as_ref(), &self.values);
            let Projection(share) = self.projection;
            // Without negative curvature the matrix is definite, so a pivot that is not positive is due to
            // rounding alone.
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

    /// Assembles the lower triangle. Rows and columns of handles are those of the identity.
    fn assemble(&mut self, trial: &Trial<'_, f64>, projection: Projection) {
        let Self { grid, hessian, .. } = self;
        let (grid, n) = (*grid, grid.particles());
        hessian.fill(trial, projection);
        for p in 0..n {
            if trial.slots[p] == 0 {
                add_own_block(trial, p, hessian);
                continue;
            }
            for (row, column) in (0..9).map(|k| (k / 3, k % 3)) {
                neighbours(grid, p).for_each(|q| *hessian.at_mut((p, row), (q, column)) = 0.0);
                *hessian.at_mut((p, row), (p, column)) = f64::from(u8::from(row == column));
            }
        }
        for (value, &source) in self.values.iter_mut().zip(&self.sources) {
            *value = hessian.values()[source as usize] as f32;
        }
    }
}

impl InverseHessian<f64> for FactoredHessian {
    fn apply(&mut self, direction: &mut [f64]) {
        let n = self.grid.particles();
        let Self { order, unknowns, .. } = self;
        for (to, &p) in unknowns.chunks_exact_mut(3).zip(order.iter()) {
            (0..3).for_each(|c| to[c] = direction[c * n + p] as f32);
        }
        LltRef::new(&self.symbolic, &self.factors).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(unknowns, 3 * n, 1),
            Par::Seq,
            MemStack::new(&mut self.workspace),
        );
        for (from, &p) in unknowns.chunks_exact(3).zip(order.iter()) {
            (0..3).for_each(|c| direction[c * n + p] = from[c].into());
        }
    }
}

/// Returns the particles in an order that causes little fill-in, and the place of each in that order.
fn minimum_degree(grid: Grid) -> Result<(Vec<usize>, Vec<usize>)> {
    let n = grid.particles();
    let (mut starts, mut rows) = (vec![0], Vec::new());
    for q in 0..n {
        rows.extend(neighbours(grid, q).filter(|&p| p > q));
        starts.push(rows.len());
    }
    let scratch = amd::order_scratch::<usize>(n, rows.len());
    let pattern = SymbolicSparseColMat::new_checked(n, n, starts, None, rows);
    let mut memory = MemBuffer::try_new(scratch).map_err(unsolved)?;
    let (mut order, mut places) = (vec![0; n], vec![0; n]);
    let stack = MemStack::new(&mut memory);
    amd::order(&mut order, &mut places, pattern.as_ref(), amd::Control::default(), stack)
        .map_err(unsolved)?;
    Ok((order, places))
}

fn unsolved(e: impl std::fmt::Debug) -> Error {
    Error::Device(format!("cpu: factoring the Hessian failed: {e:?}"))
}
