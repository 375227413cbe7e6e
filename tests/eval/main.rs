//! Evaluation: metrics, reading of sequences, scores, repeats, tables, and the search for a material.

mod common;
mod equal_time;
mod fabrics;
mod fit;
mod metrics;
#[path = "../noise/mod.rs"]
mod noise;
mod pictures;
mod repeats;
mod scores;
mod sequences;
mod suite;
mod tables;
mod trials;
