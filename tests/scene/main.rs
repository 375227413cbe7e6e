//! Scenes: documents, setups, units, and refusals.

mod common;
mod documents;
mod refusals;
mod setups;
mod units;
