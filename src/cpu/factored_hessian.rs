//! Newton steps from the sparse Hessian of a frame's energy and its Cholesky factors.

use super::cloth::{
    AFTER, Contacts, Couples, Coupling, Hessian, Projection, Trial, add_own_block, neighbours,
    repelling_pairs,
};
use crate::cloth::{Grid, Repulsion};
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
/// keeps the factors sparse. The pattern of the elastic energy is the same at every trial, so the symbolic
/// factorisation and all memory are set up once. Particles that repel each other add to the pattern: it is
/// analysed again when pairs come into range that it does not contain.
pub struct FactoredHessian {
    grid: Grid,
    hessian: Hessian,
    analysis: Analysis,
    /// Whether the analysis contains pairs of trials before the last [`FactoredHessian::reset`].
    is_stale: bool,
    /// Numbers of the lower triangle.
    values: Vec<f32>,
    /// Factors of the last trial.
    factors: Vec<f32>,
    workspace: MemBuffer,
    unknowns: Vec<f32>,
    /// The projection to try next: the last one that was needed, eased.
    projection: Projection,
}

/// The symbolic factorisation of a pattern.
struct Analysis {
    /// Pairs of particles that share no elastic term but may repel or touch each other, the smaller number first, sorted.
    pairs: Vec<(usize, usize)>,
    /// Particles in the order of the unknowns.
    order: Vec<usize>,
    /// The pattern of the lower triangle, and the place of each of its numbers: in the elastic Hessian, and past its
    /// end in the blocks of the pairs, shape [pairs, 3, 3].
    pattern: SymbolicSparseColMat<usize>,
    sources: Vec<u32>,
    symbolic: SymbolicCholesky<usize>,
}

impl Analysis {
    /// Analyses the pattern of `hessian` and those pairs. Fails if there is not enough memory.
    fn new(grid: Grid, hessian: &Hessian, pairs: Vec<(usize, usize)>) -> Result<Self> {
        let n = grid.particles();
        let mut repelled = vec![Vec::new(); n];
        for &(p, q) in &pairs {
            repelled[p].push(q);
            repelled[q].push(p);
        }
        let near = |p: usize| neighbours(grid, p).chain(repelled[p].iter().copied());
        let (order, places) = minimum_degree(n, near)?;
        let (mut starts, mut rows, mut sources) = (vec![0], Vec::new(), Vec::new());
        // Per component, on average: 2 numbers of its particle's own lower triangle, and 3 for each of the
        // particles after it.
        let most = 3 * n * (2 + 3 * AFTER) + 9 * pairs.len();
        memory::reserve(&mut rows, most, FACTORS)?;
        memory::reserve(&mut sources, most, FACTORS)?;
        let of_pair = |p: usize, q: usize| {
            let k = pairs.binary_search(&(p.min(q), p.max(q))).expect("neighbours share a term");
            hessian.values().len() + 9 * k
        };
        for (place, &q) in order.iter().enumerate() {
            let mut later: Vec<usize> = near(q).map(|p| places[p]).collect();
            later.retain(|&other| other > place);
            later.sort_unstable();
            for column in 0..3 {
                let own = (column..3).map(|row| (place, row));
                let others = later.iter().flat_map(|&other| (0..3).map(move |row| (other, row)));
                for (other, row) in own.chain(others) {
                    rows.push(3 * other + row);
                    let p = order[other];
                    let elastic = hessian.index_of((p, row), (q, column));
                    // The block of a pair is symmetric.
                    let source = elastic.unwrap_or_else(|| of_pair(p, q) + 3 * row + column);
                    sources.push(u32::try_from(source).expect("the largest grid has a billion numbers"));
                }
                starts.push(rows.len());
            }
        }
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
        Ok(Self { pairs, order, pattern, sources, symbolic })
    }

    /// Allocates the numbers of the lower triangle, those of the factors, and working memory.
    fn memory(&self) -> Result<(Vec<f32>, Vec<f32>, MemBuffer)> {
        let zeros = |len: usize| -> Result<Vec<f32>> {
            let mut numbers = Vec::new();
            memory::reserve(&mut numbers, len, FACTORS)?;
            numbers.resize(len, 0.0);
            Ok(numbers)
        };
        let workspace = StackReq::or(
            self.symbolic.factorize_numeric_llt_scratch::<f32>(Par::Seq, Default::default()),
            self.symbolic.solve_in_place_scratch::<f32>(1, Par::Seq),
        );
        let workspace = MemBuffer::try_new(workspace).map_err(unsolved)?;
        Ok((zeros(self.sources.len())?, zeros(self.symbolic.len_val())?, workspace))
    }
}

impl FactoredHessian {
    /// Analyses the pattern of a grid. Fails if there is not enough memory.
    pub fn new(grid: Grid) -> Result<Self> {
        let hessian = Hessian::new(grid)?;
        let analysis = Analysis::new(grid, &hessian, Vec::new())?;
        let (values, factors, workspace) = analysis.memory()?;
        let unknowns = vec![0.0; 3 * grid.particles()];
        Ok(Self {
            grid,
            hessian,
            analysis,
            is_stale: false,
            values,
            factors,
            workspace,
            unknowns,
            projection: FIRST,
        })
    }

    /// Forgets the trials before, which must not change what follows: the projection and the pairs that repelled
    /// each other.
    pub fn reset(&mut self) {
        self.projection = FIRST;
        self.is_stale = !self.analysis.pairs.is_empty();
    }

    /// Factors the Hessian at a trial, with that of the contacts and couples, and of the repulsion if there is one, removing about as little of its
    /// negative curvature as makes it positive definite.
    ///
    /// Full projection always gives a definite matrix but converges slowly: much of a folded sheet is
    /// compressed, and there the projected Hessian is far stiffer than the cloth.
    pub fn factor(
        &mut self,
        trial: &Trial<'_, f64>,
        repulsion: Option<Repulsion>,
        (contacts, couples): (&Contacts<f64>, &Couples<f64>),
    ) -> Result<()> {
        let pairs = repulsion.map_or_else(Vec::new, |repulsion| repelling_pairs(trial, repulsion));
        // Convex, so nothing of them needs to be removed.
        let of_layers = contacts.couplings(trial);
        let all = |projection| {
            let of_pairs = pairs.iter().map(move |pair| pair.coupling(projection));
            of_pairs.chain(of_layers.iter().copied()).chain(couples.couplings(trial, projection))
        };
        self.contain(all(Projection::NONE))?;
        loop {
            self.assemble(trial, all(self.projection), contacts, self.projection);
            let matrix = SparseColMatRef::new(self.analysis.pattern.as_ref(), &self.values);
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
            let factored = self.analysis.symbolic.factorize_numeric_llt(
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

    /// Analyses the pattern again if it lacks one of these pairs, or has those of earlier frames.
    fn contain(&mut self, couplings: impl Iterator<Item = Coupling>) -> Result<()> {
        let share_no_term = |p: usize, q: usize| self.hessian.index_of((p, 0), (q, 0)).is_none();
        let pairs =
            couplings.flat_map(|coupling| coupling.pairs().map(|(p, q, _)| (p, q)).collect::<Vec<_>>());
        let mut pairs: Vec<_> = pairs.filter(|&(p, q)| share_no_term(p, q)).collect();
        if self.is_stale || pairs.iter().any(|pair| self.analysis.pairs.binary_search(pair).is_err()) {
            pairs.sort_unstable();
            pairs.dedup();
            self.is_stale = false;
            self.analysis = Analysis::new(self.grid, &self.hessian, pairs)?;
            (self.values, self.factors, self.workspace) = self.analysis.memory()?;
        }
        Ok(())
    }

    /// Assembles the lower triangle. Rows and columns of handles are those of the identity.
    fn assemble(
        &mut self,
        trial: &Trial<'_, f64>,
        couplings: impl Iterator<Item = Coupling>,
        contacts: &Contacts<f64>,
        projection: Projection,
    ) {
        let Self { grid, hessian, analysis, values, .. } = self;
        let (grid, n) = (*grid, grid.particles());
        hessian.fill(trial, projection);
        for p in 0..n {
            if trial.marks[p].is_free() {
                add_own_block(trial, p, hessian);
                continue;
            }
            for (row, column) in (0..9).map(|k| (k / 3, k % 3)) {
                neighbours(grid, p).for_each(|q| *hessian.at_mut((p, row), (q, column)) = 0.0);
                *hessian.at_mut((p, row), (p, column)) = f64::from(u8::from(row == column));
            }
        }
        contacts.add_own_blocks(trial, hessian);
        let mut blocks = vec![[[0.0; 3]; 3]; analysis.pairs.len()];
        let is_free = |p: usize| trial.marks[p].is_free();
        for coupling in couplings {
            let block = coupling.block;
            for (p, factor) in coupling.squares().filter(|&(p, _)| is_free(p)) {
                // A number of a particle's own block and its mirror image share a place.
                for (row, column) in (0..9).map(|k| (k / 3, k % 3)).filter(|(row, column)| row >= column) {
                    *hessian.at_mut((p, row), (p, column)) += factor * block[row][column];
                }
            }
            for (p, q, factor) in coupling.pairs().filter(|&(p, q, _)| is_free(p) && is_free(q)) {
                let place = analysis.pairs.binary_search(&(p, q));
                for (row, column) in (0..9).map(|k| (k / 3, k % 3)) {
                    match place {
                        Ok(k) => blocks[k][row][column] += factor * block[row][column],
                        Err(_) => *hessian.at_mut((p, row), (q, column)) += factor * block[row][column],
                    }
                }
            }
        }
        let (elastic, blocks) = (hessian.values(), blocks.as_flattened().as_flattened());
        for (value, &source) in values.iter_mut().zip(&analysis.sources) {
            let source = source as usize;
            *value = elastic.get(source).unwrap_or_else(|| &blocks[source - elastic.len()]).to_owned() as f32;
        }
    }
}

impl InverseHessian<f64> for FactoredHessian {
    fn apply(&mut self, direction: &mut [f64]) {
        let n = self.grid.particles();
        let Self { analysis: Analysis { order, symbolic, .. }, unknowns, .. } = self;
        for (to, &p) in unknowns.chunks_exact_mut(3).zip(order.iter()) {
            (0..3).for_each(|c| to[c] = direction[c * n + p] as f32);
        }
        LltRef::new(symbolic, &self.factors).solve_in_place_with_conj(
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

/// Returns `n` particles in an order that causes little fill-in, and the place of each in that order, given those
/// that share a term with a particle.
fn minimum_degree<I: Iterator<Item = usize>>(
    n: usize,
    near: impl Fn(usize) -> I,
) -> Result<(Vec<usize>, Vec<usize>)> {
    let (mut starts, mut rows) = (vec![0], Vec::new());
    for q in 0..n {
        let first = rows.len();
        rows.extend(near(q).filter(|&p| p > q));
        rows[first..].sort_unstable();
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
