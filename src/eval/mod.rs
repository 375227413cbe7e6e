//! Evaluation of simulations: measures of their frames, and comparisons with recorded trajectories.
//!
//! ```text
//! Sequence (a trajectory of another simulator, its handles, its cloth) -> Sequence::scene on a grid -> Setup
//! Entry (an optimizer, its iterations) on a Setup -> Score: distances to the truth, stretch, energy, time
//! Scores of all sequences, grids and entries -> Tables (text, Markdown, CSV)
//! suite::Prepared (a case, its converged frames) on an entry -> CaseScore; of the iterations -> GapCurves over time
//! ```

mod alignment;
mod conditions;
pub mod drape;
mod equal_time;
pub mod fit;
mod flat_mesh;
mod frame_report;
mod gap;
mod metrics;
mod nearness;
mod physics;
mod repeats;
mod resampling;
mod score;
mod sequence;
mod soundness;
mod stretch;
pub mod suite;
mod table;
mod tables;

pub use crate::statistics::{WARM_UP, mean_and_deviation, median, median_time};
pub use conditions::{Conditions, belong_together};
pub use equal_time::{GapCurve, GapCurves, GapPoint, gap_curves, gap_tables};
pub use frame_report::FrameReport;
pub use gap::{Gap, median_gap, timed_gap, track};
pub use metrics::{TriangleMesh, chamfer, relative_error};
pub use nearness::repulsion;
pub use physics::Physics;
pub use repeats::{Nudge, OverRepeats};
pub use resampling::coarse;
pub use score::{
    Entry, PerFrame, SNAPSHOTS, Score, Settings, compare, run, snapshot_frames, snapshots, vertex_errors,
};
pub use sequence::Sequence;
pub use soundness::{Fault, GAP_LIMIT, HELD_STRETCH_LIMIT, STRETCH_LIMIT, Soundness, Verdict};
pub use stretch::FreeEdges;
pub use table::{Cell, Format, Table};
pub use tables::tables;
