//! The optimizers that minimise the energy of a frame: values that say in which directions an iteration may
//! go, and how far it goes.

use crate::network::Weights;
use crate::settings::{AdamSettings, LbfgsSettings, MAX_HISTORY};
use crate::{Error, Result};
use std::sync::Arc;

/// An optimizer of a frame's energy: in each iteration it takes the gradient at the current accelerations,
/// proposes directions, and adds a step along them.
///
/// A frame starts from `a = 0`, with [`Length::Subspace`] near the accelerations of the two frames before. The named ones
/// ([`Optimizer::named`]) are values of this type; other combinations that [`Optimizer::check`] accepts run as well, on a GPU
/// those for which [`Optimizer::runs_on_gpu`] holds.
#[derive(Clone, Debug)]
pub struct Optimizer {
    /// The directions of an iteration.
    pub directions: Vec<Direction>,
    /// How far along them it goes.
    pub length: Length,
}

/// A direction in which an iteration may go.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum Direction {
    /// Against the gradient.
    Gradient,
    /// The step of Adam with bias correction.
    Adam(AdamSettings),
    /// The direction of L-BFGS (two-loop recursion). The history is cleared every frame.
    Lbfgs {
        /// Settings of the L-BFGS.
        settings: LbfgsSettings,
        /// The inverse Hessian that it starts from.
        initial: Initial,
    },
    /// Against the gradient times the inverse Hessian of the sheet at rest, by a cosine transform, alike in x, y
    /// and z, with the reactions of its handles ([`crate::cloth::modes::Reactions`]).
    Spectral,
    /// As [`Direction::Spectral`], with an inverse of its own for each of the sheet's own axes at the predicted
    /// start of the frame: first across its surface, where it is a thousand times softer than along it, and then along it, by
    /// the forces that its stretch answers with ([`crate::cpu::optim::SheetSteps`]).
    CoRotated,
    /// The step that was taken last, or in the first iteration the accelerations that the frame starts at, near those of the
    /// two frames before. With preconditioned gradients it makes the iteration a conjugate-gradient method.
    Last,
    /// The step of the learned update rule (paper sections 3.3 and 4).
    Network(Arc<Weights>),
    /// Newton's, with sparse Cholesky factors in double precision ([`crate::cpu::Reference`]). CPU only.
    Newton,
}

/// The inverse Hessian that L-BFGS starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Initial {
    /// A multiple of the identity.
    Identity,
    /// That of the sheet at rest by a cosine transform, as if the handles were free. This is the quasi-Newton
    /// method (after Liu, Bouaziz and Kavan 2017).
    Spectral,
    /// That of the sheet at rest with the handles held, factored sparsely in double precision. CPU only.
    Factored,
}

/// How far an iteration goes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Length {
    /// This multiple of its one direction: of the gradient any, of the network's, Adam's and L-BFGS's, whose lengths
    /// are their own, 1. Nothing checks the energy.
    Fixed(f64),
    /// That of L-BFGS, corrected one iteration later to the minimum that the slopes at both ends of the step suggest.
    /// There the gradient is interpolated, so that nothing is evaluated again. Where steps turn out too long, the next
    /// ones begin shorter, but never longer than the direction.
    Secant,
    /// Until the energy decreases enough (Armijo), and as often as it takes to converge, whatever the number of
    /// iterations.
    Armijo,
    /// To the minimum of the energy's local quadratic model over all of its directions. A step that turns out to
    /// raise the energy is shortened, to a tenth to a half, so the energy of a frame never rises.
    Subspace,
}

/// Most directions of a subspace.
pub const MAX_DIRECTIONS: usize = 4;

/// Settings of L-BFGS in the paper's comparison.
const LBFGS: LbfgsSettings = LbfgsSettings { history: 5, curvature: 1e-12 };

impl Optimizer {
    /// Returns the optimizer with one direction and a fixed length.
    fn fixed(direction: Direction, length: f64) -> Self {
        Self { directions: vec![direction], length: Length::Fixed(length) }
    }

    /// Returns the learned optimizer: the step of the network and the directions of [`Optimizer::spectral`], and
    /// the best step among them.
    pub fn learned(weights: impl Into<Arc<Weights>>) -> Self {
        let mut optimizer = Self::spectral();
        optimizer.directions.push(Direction::Network(weights.into()));
        optimizer
    }

    /// Returns the learned optimizer as published: the step of the network is taken as it is.
    pub fn paper(weights: impl Into<Arc<Weights>>) -> Self {
        Self::fixed(Direction::Network(weights.into()), 1.0)
    }

    /// Returns the classical optimizer without weights: the spectral and the co-rotated direction and the last
    /// step, and the best step among them.
    pub fn spectral() -> Self {
        let directions = vec![Direction::Spectral, Direction::CoRotated, Direction::Last];
        Self { directions, length: Length::Subspace }
    }

    /// Returns gradient descent with a rate.
    pub fn descent(rate: f64) -> Self {
        Self::fixed(Direction::Gradient, rate)
    }

    /// Returns gradient descent as in the paper's comparison (section 4.3): rate 0.01.
    pub fn gradient_descent() -> Self {
        Self::descent(0.01)
    }

    /// Returns Adam as in the paper's comparison: rate 0.1, decays 0.9 and 0.999.
    pub fn adam() -> Self {
        let settings = AdamSettings { rate: 0.1, beta1: 0.9, beta2: 0.999, epsilon: 1e-8 };
        Self::fixed(Direction::Adam(settings), 1.0)
    }

    /// Returns L-BFGS as in the authors' comparison: history 5, step 1, pairs with `y.s > 1e-12`.
    pub fn lbfgs() -> Self {
        Self::lbfgs_with(LBFGS)
    }

    /// Returns L-BFGS with step 1 and these settings.
    pub fn lbfgs_with(settings: LbfgsSettings) -> Self {
        Self::fixed(Direction::Lbfgs { settings, initial: Initial::Identity }, 1.0)
    }

    /// Returns L-BFGS along secants, from this inverse Hessian: history 5, pairs with `y.s > 1e-12`.
    fn secant(initial: Initial) -> Self {
        let directions = vec![Direction::Lbfgs { settings: LBFGS, initial }];
        Self { directions, length: Length::Secant }
    }

    /// Returns the quasi-Newton method: history 5, pairs with `y.s > 1e-12`.
    pub fn quasi_newton() -> Self {
        Self::secant(Initial::Spectral)
    }

    /// Returns the quasi-Newton method with exact factors of the Hessian at rest. CPU only.
    pub fn quasi_newton_exact() -> Self {
        Self::secant(Initial::Factored)
    }

    /// Returns Newton's method until it converges: the exact physics, for comparison. CPU only.
    pub fn newton() -> Self {
        Self { directions: vec![Direction::Newton], length: Length::Armijo }
    }

    /// Returns the optimizer called `name`, the classical ones with the paper's settings, the learned ones with
    /// the result of `weights`. `origin` names the source of the name in errors.
    pub fn named(name: &str, origin: &str, weights: impl FnOnce() -> Result<Weights>) -> Result<Self> {
        match name {
            FNOPT => return Ok(Self::learned(weights()?)),
            PAPER => return Ok(Self::paper(weights()?)),
            _ => {}
        }
        let classical = [
            Self::spectral(),
            Self::gradient_descent(),
            Self::adam(),
            Self::lbfgs(),
            Self::quasi_newton(),
            Self::quasi_newton_exact(),
            Self::newton(),
        ];
        let known = [FNOPT, PAPER].into_iter().chain(classical.iter().map(Self::name));
        let unknown = Error::unknown(origin, "solver", name, known);
        classical.into_iter().find(|optimizer| optimizer.name() == name).ok_or(unknown)
    }

    /// Fails if no solver can run it: a subspace has one to four different directions, each other length exactly
    /// one that it suits; the weights must be whole ([`Weights::check`]), and a
    /// history must be neither empty nor too long for the kernels.
    pub fn check(&self) -> Result<()> {
        let refused = |field: &str, expected: String, found: String| {
            Err(Error::invalid("optimizer", field, expected, found))
        };
        let names = || self.directions.iter().map(Direction::name).collect::<Vec<_>>().join(", ");
        let count = self.directions.len();
        match self.length {
            Length::Subspace => {
                if !(1..=MAX_DIRECTIONS).contains(&count) {
                    return refused(
                        "directions",
                        format!("1 to {MAX_DIRECTIONS} in a subspace"),
                        count.to_string(),
                    );
                }
                let allowed = [Direction::Spectral, Direction::CoRotated, Direction::Last].map(|d| d.name());
                let suits = |d: &Direction| allowed.contains(&d.name()) || matches!(d, Direction::Network(_));
                let mut seen = Vec::new();
                for direction in &self.directions {
                    if !suits(direction) || seen.contains(&direction.name()) {
                        let expected = format!("different ones of {} and network", allowed.join(", "));
                        return refused("directions of a subspace", expected, names());
                    }
                    seen.push(direction.name());
                }
            }
            Length::Armijo if !matches!(self.directions[..], [Direction::Newton]) => {
                return refused("directions of a line search", "newton alone".into(), names());
            }
            Length::Fixed(length) => {
                let own_length = match self.directions[..] {
                    [Direction::Gradient] => false,
                    // From another start than the identity, as if the handles were free, its steps are too long.
                    [
                        Direction::Network(_)
                        | Direction::Adam(_)
                        | Direction::Lbfgs { initial: Initial::Identity, .. },
                    ] => true,
                    _ => return refused("directions", "one that a fixed length suits".into(), names()),
                };
                if own_length && length != 1.0 {
                    let expected = format!("1, because {} has its own", names());
                    return refused("length", expected, length.to_string());
                }
                if !length.is_finite() {
                    return refused("length", "a finite number".into(), length.to_string());
                }
            }
            Length::Secant if !matches!(self.directions[..], [Direction::Lbfgs { .. }]) => {
                return refused("directions of a secant", "lbfgs alone".into(), names());
            }
            Length::Armijo | Length::Secant => {}
        }
        for direction in &self.directions {
            match *direction {
                Direction::Network(ref weights) => weights.check("the optimizer's weights")?,
                Direction::Lbfgs { settings: LbfgsSettings { history, .. }, .. }
                    if !(1..=MAX_HISTORY).contains(&history) =>
                {
                    return refused("history", format!("1 to {MAX_HISTORY} pairs"), history.to_string());
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Whether it has GPU kernels; the others run on the CPU only. Of subspaces, those of [`Optimizer::spectral`] and
    /// [`Optimizer::learned`] have, with their directions in that order.
    pub fn runs_on_gpu(&self) -> bool {
        use Direction::{CoRotated, Last, Lbfgs, Network, Newton, Spectral};
        match (&self.directions[..], self.length) {
            ([Spectral, CoRotated, Last] | [Spectral, CoRotated, Last, Network(_)], Length::Subspace) => true,
            (_, Length::Subspace) | ([Newton | Lbfgs { initial: Initial::Factored, .. }], _) => false,
            _ => true,
        }
    }

    /// Whether it iterates until it converges, whatever the number of iterations.
    pub fn converges(&self) -> bool {
        self.length == Length::Armijo
    }

    /// Returns the number of iterations per frame that suits it where none is asked for. The best step among several
    /// directions follows the exact motion with twenty; ten leave it to chance which way a fold goes. Gradient descent,
    /// as in the paper's comparison, would need a hundred thousand.
    pub fn default_iterations(&self) -> usize {
        match (&self.directions[..], self.length) {
            (_, Length::Subspace) => 20,
            ([Direction::Adam(_) | Direction::Lbfgs { initial: Initial::Identity, .. }], _) => 100,
            ([Direction::Lbfgs { initial: Initial::Spectral, .. }], _) => 40,
            ([Direction::Lbfgs { initial: Initial::Factored, .. }], _) => 20,
            _ => 10,
        }
    }

    /// Returns the weights of the network among its directions.
    pub fn weights(&self) -> Option<&Arc<Weights>> {
        self.directions.iter().find_map(|direction| match direction {
            Direction::Network(weights) => Some(weights),
            _ => None,
        })
    }

    /// Returns the checksum of the weights ([`Weights::checksum`]) in hexadecimal digits; `None` for the
    /// classical optimizers.
    pub fn weights_crc32(&self) -> Option<String> {
        self.weights().map(|weights| format!("{:08x}", weights.checksum()))
    }

    /// Returns the optimizer's name on command lines and in reports; "custom" for combinations without one.
    pub fn name(&self) -> &'static str {
        use Direction::{Adam, CoRotated, Gradient, Last, Lbfgs, Network, Newton, Spectral};
        match (&self.directions[..], self.length) {
            ([Spectral, CoRotated, Last, Network(_)], Length::Subspace) => FNOPT,
            ([Spectral, CoRotated, Last], Length::Subspace) => "spectral",
            ([Network(_)], Length::Fixed(_)) => PAPER,
            ([Gradient], Length::Fixed(_)) => "gd",
            ([Adam(_)], Length::Fixed(_)) => "adam",
            ([Lbfgs { initial: Initial::Identity, .. }], Length::Fixed(_)) => "lbfgs",
            ([Lbfgs { initial: Initial::Spectral, .. }], Length::Secant) => "quasi-newton",
            ([Lbfgs { initial: Initial::Factored, .. }], Length::Secant) => "quasi-newton-exact",
            ([Newton], Length::Armijo) => "newton",
            _ => "custom",
        }
    }
}

/// Name of the learned optimizer.
const FNOPT: &str = "fnopt";
/// Name of the learned optimizer as published.
const PAPER: &str = "fnopt-paper";

impl Direction {
    /// Returns the direction's name in errors.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Gradient => "gradient",
            Self::Adam(_) => "adam",
            Self::Lbfgs { .. } => "lbfgs",
            Self::Spectral => "spectral",
            Self::CoRotated => "co-rotated",
            Self::Last => "last",
            Self::Network(_) => "network",
            Self::Newton => "newton",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn named_optimizers_run_and_keep_their_names() {
        for name in ["fnopt", "fnopt-paper", "spectral", "gd", "adam", "lbfgs", "quasi-newton", "newton"] {
            let optimizer = Optimizer::named(name, "test", || Ok(Weights::shipped())).unwrap();
            assert_eq!(optimizer.name(), name);
            optimizer.check().unwrap();
        }
    }

    #[test]
    fn other_subspaces_than_the_named_ones_run_on_the_cpu_alone() {
        let weights = Arc::new(Weights::zeros(crate::network::Config::default()));
        let network = || Direction::Network(weights.clone());
        let subspace = |directions: Vec<Direction>| Optimizer { directions, length: Length::Subspace };
        for optimizer in
            [Optimizer::spectral(), Optimizer::learned(weights.clone()), Optimizer::quasi_newton()]
        {
            assert!(optimizer.runs_on_gpu(), "{}", optimizer.name());
        }
        for directions in [
            vec![Direction::Spectral, Direction::Last],
            vec![Direction::CoRotated, Direction::Spectral, Direction::Last],
            vec![network(), Direction::Spectral, Direction::CoRotated, Direction::Last],
        ] {
            let optimizer = subspace(directions);
            optimizer.check().unwrap();
            assert!(!optimizer.runs_on_gpu(), "{:?}", optimizer.directions);
        }
        assert!(!Optimizer::newton().runs_on_gpu() && !Optimizer::quasi_newton_exact().runs_on_gpu());
    }

    #[test]
    fn weights_that_a_host_built_wrongly_are_refused_by_name() {
        let refused = |spoil: &dyn Fn(&mut Weights)| {
            let mut weights = Weights::zeros(crate::network::Config::default());
            Optimizer::learned(weights.clone()).check().unwrap();
            spoil(&mut weights);
            Optimizer::paper(weights).check().unwrap_err().to_string()
        };
        let found = refused(&|w| w.blocks[2].skip.truncate(10));
        assert!(found.contains("fno_blocks.fno_skips.2.conv.weight: expected 4096 numbers"), "{found}");
        assert!(refused(&|w| w.lifting.swap(0, 1)).contains("lifting.fcs.0.weight: expected 1280"));
        assert!(refused(&|w| drop(w.blocks.pop())).contains("blocks: expected 4 of them, found 3"));
        assert!(refused(&|w| w.config.modes_h = usize::MAX).contains("positive sizes"));
        assert!(refused(&|w| w.config.fields = 4).contains("3 fields"));
    }

    #[test]
    fn combinations_without_sense_are_refused_by_name() {
        let refused = |directions: Vec<Direction>, length| {
            Optimizer { directions, length }.check().unwrap_err().to_string()
        };
        let none = refused(vec![], Length::Subspace);
        assert!(none.contains("1 to 4 in a subspace") && none.contains('0'), "{none}");
        assert!(refused(vec![Direction::Spectral; 5], Length::Subspace).contains('5'));
        assert!(refused(vec![Direction::Last; 2], Length::Subspace).contains("last, last"));
        assert!(refused(vec![Direction::Newton], Length::Subspace).contains("newton"));
        assert!(refused(vec![Direction::Gradient], Length::Armijo).contains("gradient"));
        assert!(refused(vec![Direction::Last], Length::Fixed(1.0)).contains("last"));
        assert!(refused(vec![Direction::Spectral], Length::Fixed(1.0)).contains("spectral"));
        assert!(refused(vec![], Length::Fixed(1.0)).contains("directions"));
        let settings = LBFGS;
        let lbfgs = Direction::Lbfgs { settings, initial: Initial::Identity };
        assert!(refused(vec![lbfgs], Length::Fixed(0.5)).contains("1, because lbfgs has its own"));
        assert!(refused(vec![Direction::Spectral], Length::Secant).contains("lbfgs alone"));
        assert!(refused(vec![Direction::Gradient], Length::Fixed(f64::NAN)).contains("NaN"));
    }
}
