//! Each shader against the CPU path in double precision, or against its formula where the CPU path has no such seam.
//!
//! Outputs start as NaN, so that an element that is not written shows. Tolerances are a few roundings of the terms that
//! are summed; each file says how many.

mod adam;
mod block;
mod classical;
mod cloth;
mod energy;
mod external_force;
mod features;
mod gradient;
mod gradient_descent;
mod integrate;
mod inverse_columns;
mod lbfgs;
mod norms;
mod operator;
mod pointwise;
mod pool_rows;
mod predict;
mod project;
mod real_fft2;
mod rescale;
mod scalar_head;
mod spectral;
mod transform_columns;
mod transform_rows;
mod update;
