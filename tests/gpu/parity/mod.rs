//! Each shader against the CPU path in double precision, or against its formula where the CPU path has no such seam.
//!
//! Outputs start as NaN, so that an element that is not written shows. Tolerances are a few roundings of the terms that
//! are summed; each file says how many.

mod real_fft2;
