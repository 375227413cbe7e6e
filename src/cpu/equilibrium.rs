//! The static equilibrium of a cloth: where it hangs still.

use super::Objective;
use super::optim::norm;
use super::reference::{Reference, hold};
use crate::Result;
use crate::cloth::{Air, Cloth, Control, Material, Model, State};

/// |dL/da| over the free particles, at a = 0 from rest, at which a cloth counts as still. The frames of a drape of 1 m
/// then begin at some 1e-6 m/s.
const STILL: f64 = 1e-9;
/// Durations of the frames that lead to it, in frames of the cloth: the first, the longest, and the factor between
/// them.
const FIRST: f64 = 64.0;
const LONGEST: f64 = 512.0;
const LONGER: f64 = 4.0;
/// Most iterations of one of these frames: a shorter one converges in fewer.
const ITERATIONS: usize = 200;
/// Most of these frames, and most that may not converge.
const FRAMES: usize = 40;
const UNCONVERGED: usize = 8;
/// A cloth that moved farther than this, in its perimeter, is held by nothing.
const FARTHEST: f64 = 2.0;

/// A cloth as [`equilibrium`] leaves it.
#[derive(Clone, Debug, PartialEq)]
pub struct Equilibrium {
    /// Positions \[edges\], shape [3, H, W]: as they were if the cloth fell, because nothing holds it.
    pub x: Vec<f64>,
    /// |dL/da| over the free particles in a frame that starts there from rest.
    pub gradient: f64,
}

impl Equilibrium {
    /// Whether the cloth is still.
    pub fn is_still(&self) -> bool {
        self.gradient <= STILL
    }
}

/// Lets one cloth come to rest from positions `x` [3, H, W], with its handles where they are there, in still air
/// and far from bodies.
///
/// A backward-Euler frame that starts at rest moves the cloth towards its equilibrium, the farther, the longer the
/// frame: scaled by the square of the duration, the elastic energy and the work of gravity outweigh the inertia. So a
/// few long frames, each from rest and minimised by Newton's method, end in a minimum of those two. Fails as
/// [`Reference::new`] does. Panics if the length does not match the model.
pub fn equilibrium(model: &Model, x: &[f64]) -> Result<Equilibrium> {
    let n = model.grid.particles();
    let cloth =
        Cloth { air: Air::default(), self_contact: None, bodies: Vec::new(), ..model.cloths[0].clone() };
    let mut reference = Reference::new(&Model { grid: model.grid, cloths: vec![cloth.clone()] })?;
    reference.iterations = ITERATIONS;
    let handles = cloth.handles.iter().map(|&p| [x[p], x[n + p], x[2 * n + p]]).collect();
    let control = Control { handles, ..Default::default() };
    let still = vec![0.0; 3 * n];
    let mut state = State { x: x.to_vec(), v: still.clone() };
    let at_rest = Model { grid: model.grid, cloths: vec![cloth.clone()] };
    let mut objective = Objective::new(&at_rest);
    let mut force = |state: &State<f64>| {
        objective.begin_frame(state, &control);
        objective.evaluate(state, &control);
        let mut grad = objective.grad().to_vec();
        hold(&at_rest, &mut grad);
        norm(&grad)
    };
    let reach = FARTHEST * 2.0 * (model.grid.h + model.grid.w) as f64;
    let (mut gradient, mut duration, mut unconverged) = (force(&state), FIRST, 0);
    for _ in 0..FRAMES {
        if gradient <= STILL || unconverged > UNCONVERGED {
            break;
        }
        reference.set_cloth(&longer(&cloth, duration));
        let minimum = reference.minimise(&state, &control, &still);
        reference.end_frame(&mut state, &control);
        if !state.x.iter().zip(x).all(|(now, before)| (now - before).abs() <= reach) {
            return Ok(Equilibrium { x: x.to_vec(), gradient: f64::INFINITY });
        }
        state.v.fill(0.0);
        if minimum.converged {
            duration = (duration * LONGER).min(LONGEST);
        } else {
            duration = (duration / LONGER).max(1.0);
            unconverged += 1;
        }
        gradient = force(&state);
    }
    Ok(Equilibrium { x: state.x, gradient })
}

/// Returns the cloth for frames that last `duration` of its own.
fn longer(cloth: &Cloth, duration: f64) -> Cloth {
    let square = duration * duration;
    let material = cloth.material;
    Cloth {
        material: Material {
            stretch: material.stretch * square,
            shear: material.shear * square,
            bend: material.bend * square,
            ..material
        },
        // At rest nothing is damped.
        damping: 0.0,
        gravity: cloth.gravity.map(|g| g * square),
        repulsion: cloth.repulsion.map(|mut repulsion| {
            repulsion.strength *= square;
            repulsion
        }),
        ..cloth.clone()
    }
}
