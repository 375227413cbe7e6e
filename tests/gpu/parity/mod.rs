//! Each shader against the CPU path in double precision, or against its formula if the CPU path lacks that
//! stage.
//!
//! Outputs start as NaN, so that an element that is not written shows. Tolerances are a few roundings of the
//! terms that are summed; each file says how many.

mod adam;
mod adamw;
mod block;
mod cells;
mod classical;
mod cloth;
mod contact;
mod couple;
mod curvature;
mod draw;
mod embed;
mod energy;
mod external_force;
mod extrapolate;
mod features;
mod gelu_adj;
mod gradient;
mod gradient_descent;
mod gradient_size;
mod head_weight_adj;
mod integrate;
mod layers;
mod lbfgs;
mod multiply_add;
mod operator;
mod pointwise;
mod pointwise_weight_adj;
mod pool_adj;
mod pool_rows;
mod predict;
mod project;
mod project_adj;
mod quasi_newton;
mod real_fft2;
mod repulsion;
mod repulsion_curvature;
mod scalar_head;
mod sheet_axes;
mod sheet_steps;
mod spectral;
mod spectral_weight_adj;
mod subspace_step;
mod transform_rows;
mod transpose;
mod update;
mod update_adj;
mod vertices;
