//! Each shader against the CPU path in double precision, or against its formula where the CPU path has no such seam.
//!
//! Outputs start as NaN, so that an element that is not written shows. Tolerances are a few roundings of the terms that
//! are summed; each file says how many.

mod block;
mod inverse_columns;
mod operator;
mod pointwise;
mod pool_rows;
mod project;
mod real_fft2;
mod scalar_head;
mod spectral;
mod transform_columns;
mod transform_rows;
