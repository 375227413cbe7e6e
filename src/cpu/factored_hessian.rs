//! The sparse Hessian of a frame's energy and its Cholesky factors: a Newton step.

use super::cloth::{AFTER, Hessian, Projection, Trial, neighbours};
use crate::cpu::optim::InverseHessian;
use crate::sim::Grid;
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

/// What there is no memory for.
const FACTORS: &str = "a Hessian's factors";

/// The least pivot of a definite matrix, beside its largest element.
const ROUNDING: f32 = 1e-6;

/// The inverse Hessian of a cloth at a trial, by its Cholesky factors in single precision: a step is measured on the energy
/// itself, and what rounding adds to one is undone by the next.
///
/// The unknowns are the components of one particle after the other, particles in an order that leaves the factors sparse (minimum
/// degree). The pattern is the same at every trial, so that its symbolic factorisation and all memory are made once.
pub struct FactoredHessian {
    grid: Grid,
    hessian: Hessian,
    /// Particles by their place among the unknowns.
    order: Vec<usize>,
    /// The lower triangle, and where in the Hessian each of its numbers is.
    pattern: SymbolicSparseColMat<usize>,
    sources: Vec<u32>,
    values: Vec<f32>,
    symbolic: SymbolicCholesky<usize>,
    /// Of the last trial that was factored.
    factors: Vec<f32>,
    workspace: MemBuffer,
    unknowns: Vec<f32>,
    /// What was needed last, eased.
    projection: Projection,
}

impl FactoredHessian {
    /// Analyses the pattern of a grid; an error when memory does not suffice.
    pub fn new(grid: Grid) -> Result<Self> {
        let n = grid.particles();
        let hessian = Hessian::new(grid)?;
        let (order, places) = minimum_degree(grid)?;
        let (mut starts, mut rows, mut sources) = (vec![0], Vec::new(), Vec::new());
        // Of a component: the lower half of what it shares with its own particle and with the others.
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
                    let source = hessian.place((order[other], row), (q, column));
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
            // With the identity for an ordering faer analyses the upper triangle; what it factors is the lower one as it is.
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

    /// Sets the lower triangle; a handle's rows and columns are those of the unit matrix.
    fn assemble(&mut self, trial: &Trial<'_, f64>, projection: Projection) {
        let Self { grid, hessian, .. } = self;
        let (grid, n) = (*grid, grid.particles());
        hessian.fill(trial, projection);
        for p in 0..n {
            if trial.slots[p] == 0 {
                let mass = grid.mass(p / grid.w, p % grid.w) / n as f64;
                (0..3).for_each(|c| *hessian.at_mut((p, c), (p, c)) += mass);
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

/// Particles in an order of few fill-ins, and the place of each.
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
    Error::Device(format!("cpu: the Hessian cannot be factored: {e:?}"))
}
