//! Scenes: documents, setups, units, and refusals.

mod bodies;
mod common;
mod documents;
mod events;
mod fabrics;
mod meshes;
mod named;
mod refusals;
mod setups;
mod simulation;
mod uneven;
mod units;
