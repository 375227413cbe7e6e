//! Scenes: documents, what is made of them, units, and refusals.

mod common;
mod documents;
mod refusals;
mod setups;
mod units;
