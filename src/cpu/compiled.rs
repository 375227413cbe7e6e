//! The costly functions of the CPU path, compiled once for each precision.
//!
//! A generic function is compiled anew in every crate that calls it, with its vectorised loops for each kind of
//! processor: half a minute for every test, example and host. The methods of this trait belong to two types alone, so
//! this crate holds their code and all others link to it.

use super::cloth::{CurvatureRows, GradientRows, LocalModel, Trial};
use super::matmul::{Target, Term};
use super::optim::Minimizer;
use super::{Objective, Real, Solver, cloth, matmul, optim};
use crate::Result;
use crate::cloth::{Control, EnergyTerms, Model, State};
use crate::sim::{FrameStats, Optimizer};

/// Functions of the same names, or methods of the type that is their first argument.
pub trait Compiled: Sized {
    fn energy(trial: &Trial<'_, Self>) -> EnergyTerms;
    fn gradient(trial: &Trial<'_, Self>, rows: &mut GradientRows<Self>, grad: &mut [Self]);
    fn local_model(
        trial: &Trial<'_, Self>,
        rows: &mut CurvatureRows<Self>,
        directions: &[Self],
        grad: &[Self],
    ) -> LocalModel;

    fn product(target: Target<'_, Self>, terms: &[Term<'_, Self>]);
    fn weighted_rows(out: &mut [Self], start: Self, a: &[Self], weight: &[Self]);
    fn add_rows(sums: &mut [Self], rows: &[Self]);
    fn largest_rows(largest: &mut [Self], rows: &[Self]);

    fn evaluate(objective: &mut Objective<Self>, state: &State<Self>, control: &Control<Self>)
    where
        Self: Real;
    fn minimizer(optimizer: &Optimizer, model: &Model) -> Result<Box<dyn Minimizer<Self>>>
    where
        Self: Real;
    fn new_solver(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Solver<Self>>
    where
        Self: Real;
    fn frame(solver: &mut Solver<Self>, state: &mut State<Self>, control: &Control<Self>) -> Vec<FrameStats>
    where
        Self: Real;
}

macro_rules! compiled {
    ($real:ty) => {
        impl Compiled for $real {
            fn energy(trial: &Trial<'_, Self>) -> EnergyTerms {
                cloth::generic_energy(trial)
            }
            fn gradient(trial: &Trial<'_, Self>, rows: &mut GradientRows<Self>, grad: &mut [Self]) {
                cloth::generic_gradient(trial, rows, grad);
            }
            fn local_model(
                trial: &Trial<'_, Self>,
                rows: &mut CurvatureRows<Self>,
                directions: &[Self],
                grad: &[Self],
            ) -> LocalModel {
                cloth::generic_local_model(trial, rows, directions, grad)
            }

            fn product(target: Target<'_, Self>, terms: &[Term<'_, Self>]) {
                matmul::generic_product(target, terms);
            }
            fn weighted_rows(out: &mut [Self], start: Self, a: &[Self], weight: &[Self]) {
                matmul::generic_weighted_rows(out, start, a, weight);
            }
            fn add_rows(sums: &mut [Self], rows: &[Self]) {
                matmul::generic_add_rows(sums, rows);
            }
            fn largest_rows(largest: &mut [Self], rows: &[Self]) {
                matmul::generic_largest_rows(largest, rows);
            }

            fn evaluate(objective: &mut Objective<Self>, state: &State<Self>, control: &Control<Self>) {
                objective.generic_evaluate(state, control);
            }
            fn minimizer(optimizer: &Optimizer, model: &Model) -> Result<Box<dyn Minimizer<Self>>> {
                optim::generic_minimizer(optimizer, model)
            }
            fn new_solver(model: &Model, optimizer: &Optimizer, iterations: usize) -> Result<Solver<Self>> {
                Solver::generic_new(model, optimizer, iterations)
            }
            fn frame(
                solver: &mut Solver<Self>,
                state: &mut State<Self>,
                control: &Control<Self>,
            ) -> Vec<FrameStats> {
                solver.generic_frame(state, control)
            }
        }
    };
}

compiled!(f32);
compiled!(f64);
