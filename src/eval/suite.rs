//! Suites that measure how well a solver generalises: the default scene with other motions, handles, speeds,
//! grids, materials or numbers of iterations, or with repulsion, and the scenes that come with the library, evaluated without
//! another simulator as reference.

use super::gap::{timed_gap, track};
use super::nearness::{LayerProximity, mean_and_fractions_above};
use super::score::{keep, read_kept, simulate};
use super::tables::DIVERGED;
use super::{Cell, Conditions, Entry, Fault, Table, Verdict};
use crate::Device;
use crate::cloth::{Grid, Material};
use crate::cpu::Track;
use crate::io::Trajectory;
use crate::scene::{
    BuiltIn, Handles, Motion, Placement, RepulsionSettings, Scene, Setup, Start, Stiffness, named_scenes,
};
use crate::sim::Optimizer;
use crate::statistics::median;
use crate::{Error, Result};
use rayon::prelude::*;
use std::cell::OnceCell;
use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;

/// The numbers of iterations of [`Suite::Iterations`].
pub const ITERATIONS: [usize; 8] = [3, 5, 8, 10, 15, 20, 25, 30];

/// The property that a suite varies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Suite {
    /// All built-in motions.
    Motions,
    /// All placements of handles, for a drape that is released (`drape`) and a flat sheet that is dropped
    /// (`flat`).
    Handles,
    /// The default motion played at 1, 1.2, 1.5 and 2 times its speed.
    Speeds,
    /// Non-square grids, and fine ones.
    Grids,
    /// Stretch coefficients 100 to 1000 combined with bend coefficients 0.01 to 10.
    Materials,
    /// 3 to 30 iterations.
    Iterations,
    /// Two placements of handles with which the sheet folds onto itself, without and with repulsion (the
    /// paper's Table 5).
    Repulsion,
    /// The scenes that come with the library ([`named_scenes`]), apart from those with events.
    Scenes,
}

/// A scene of a suite.
#[derive(Clone, Debug)]
pub struct Case {
    /// Name, which says what distinguishes the case.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// Iterations per frame, if the suite sets them.
    pub iterations: Option<usize>,
}

impl Case {
    /// Returns a case of [`Suite::Iterations`]: the default scene with a number of iterations per frame.
    fn of_iterations(iterations: usize) -> Self {
        let name = format!("{iterations} iterations");
        Self { name, scene: Scene::default(), iterations: Some(iterations) }
    }

    /// Whether a solver takes part with its own number of iterations in this case of [`Suite::Iterations`]; one
    /// that converges takes part in the case without a number.
    pub fn is_of(&self, entry: &Entry) -> bool {
        self.iterations == Some(entry.iterations).filter(|_| !entry.optimizer.converges())
    }
}

/// Returns the cases of [`Suite::Iterations`] on a grid that the solvers need: one for each of their numbers of
/// iterations, in ascending order, then one for those that converge.
pub fn cases_of_iterations(grid: Grid, entries: &[Entry]) -> Result<Vec<Case>> {
    let (converging, others): (Vec<&Entry>, Vec<&Entry>) =
        entries.iter().partition(|entry| entry.optimizer.converges());
    let numbers: BTreeSet<usize> = others.iter().map(|entry| entry.iterations).collect();
    let converged = Case { name: "converged".into(), scene: Scene::default(), iterations: None };
    let last = (!converging.is_empty()).then_some(converged);
    let mut cases: Vec<Case> = numbers.into_iter().map(Case::of_iterations).chain(last).collect();
    cases.iter_mut().try_for_each(|case| case.scene.regrid(grid))?;
    Ok(cases)
}

/// The result of a solver in a case.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct CaseScore {
    /// Name of the case.
    pub case: String,
    /// The grid, as in `32x32`.
    pub grid: String,
    /// Iterations per frame.
    pub iterations: usize,
    /// Whether all frames were finite and of plausible size.
    pub stable: bool,
    /// What the rollout was like.
    #[serde(flatten)]
    pub verdict: Verdict,
    /// Median energy gap `(L_N - L_ref) / (L_0 - L_ref)` on the frames of a converged simulation; `None` if
    /// it was not requested or is not finite.
    pub gap: Option<f64>,
    /// Median wall time \[ms\] of the frames of the gap, of each frame alone ([`Gap`](super::Gap)); `None` if
    /// the gap was not requested.
    #[serde(default)]
    pub gap_ms_per_frame: Option<f64>,
    /// Median wall time of a frame of the simulation \[ms\], in which a GPU computes a frame while the one before
    /// it is measured; `None` if the first frame diverged.
    pub ms_per_frame: Option<f64>,
    /// How near the layers came to each other: the mean over the frames of the repulsion energy on a grid of
    /// 32 rows, and the shares of frames in which it exceeds 0.1 and 0.02 (paper section 6.3.3). `None` if
    /// the simulation diverged.
    #[serde(default)]
    pub repulsion: Option<[f64; 3]>,
    /// The conditions of the score; `settings` holds the scene, its number of frames, and whether the gap was
    /// requested.
    pub made_with: Conditions,
}

impl CaseScore {
    /// Reads a score that [`CaseScore::write`] wrote.
    pub fn read(path: &Path) -> Result<Self> {
        read_kept(path)
    }

    /// Writes the score as JSON.
    pub fn write(&self, path: &Path) -> Result<()> {
        keep(path, self)
    }

    /// Whether its gap, if there is one, has a time, which a score stored by an earlier version lacks.
    pub fn is_whole(&self) -> bool {
        self.gap.is_none() || self.gap_ms_per_frame.is_some()
    }

    /// Returns the energy gap if it was requested; infinite if it is not finite.
    pub(crate) fn measured_gap(&self) -> Option<f64> {
        (self.made_with.settings["gap"] == true).then(|| self.gap.unwrap_or(f64::INFINITY))
    }

    /// Whether the rollout was sound: finite, and nothing wrong with it ([`Verdict::faults`]).
    pub fn sound(&self) -> bool {
        self.stable && self.verdict.is_sound()
    }
}

impl Suite {
    /// The suites by name.
    pub const ALL: [(&str, Self); 8] = [
        ("motions", Self::Motions),
        ("handles", Self::Handles),
        ("speeds", Self::Speeds),
        ("grids", Self::Grids),
        ("materials", Self::Materials),
        ("iterations", Self::Iterations),
        ("repulsion", Self::Repulsion),
        ("scenes", Self::Scenes),
    ];

    /// Returns the suite called `name`; `origin` says where the name comes from, for errors.
    pub fn named(name: &str, origin: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|(known, _)| *known == name).map(|(_, suite)| suite);
        found.ok_or_else(|| Error::unknown(origin, "suite", name, Self::ALL.map(|(known, _)| known)))
    }

    /// Returns the cases on a grid; [`Suite::Grids`] uses its own grids instead, and [`Suite::Scenes`] grids with as many rows.
    pub fn cases(self, grid: Grid) -> Result<Vec<Case>> {
        let mut cases: Vec<Case> = Vec::new();
        let mut push = |name: String, scene: Scene| cases.push(Case { name, scene, iterations: None });
        match self {
            Self::Motions => {
                for name in BuiltIn::names() {
                    let motion = BuiltIn::named(&name).map_or(Motion::Still, Motion::BuiltIn);
                    push(name, Scene { motion, ..Scene::default() });
                }
            }
            Self::Handles => {
                for placement in Placement::ALL {
                    for (kind, start) in [("drape", Start::Settled), ("flat", Start::Flat)] {
                        let handles = Handles::Placement(placement);
                        let scene = Scene { handles, start, motion: Motion::Still, ..Scene::default() };
                        push(format!("{} {kind}", placement.name()), scene);
                    }
                }
            }
            Self::Speeds => {
                for speed in [1.0, 1.2, 1.5, 2.0] {
                    push(format!("speed {speed}"), Scene { speed, ..Scene::default() });
                }
            }
            Self::Grids => {
                let sides =
                    [(48, 32), (32, 48), (64, 32), (32, 64), (100, 32), (32, 100), (64, 64), (100, 100)];
                for (h, w) in sides {
                    let mut scene = Scene::default();
                    scene.regrid(Grid { h, w })?;
                    push(scene.grid.to_string(), scene);
                }
                return Ok(cases);
            }
            Self::Materials => {
                for stretch in [100.0, 300.0, 1000.0] {
                    for bend in [0.01, 0.1, 1.0, 10.0] {
                        let material = Material { stretch, shear: 8.0, bend, ..Material::PAPER };
                        let stiffness = Stiffness::Grid(material);
                        push(
                            format!("stretch {stretch} bend {bend}"),
                            Scene { stiffness, ..Scene::default() },
                        );
                    }
                }
            }
            Self::Iterations => cases.extend(ITERATIONS.map(Case::of_iterations)),
            Self::Repulsion => {
                for (placement, motion) in
                    [(Placement::CornerCenter, "rot_h1"), (Placement::SingleMidEdge, "xy_v2")]
                {
                    for (kind, repulsion) in [("without", None), ("with", Some(RepulsionSettings::default()))]
                    {
                        let motion = BuiltIn::named(motion).map_or(Motion::Still, Motion::BuiltIn);
                        let handles = Handles::Placement(placement);
                        let scene = Scene { handles, motion, repulsion, ..Scene::default() };
                        push(format!("{} {kind}", placement.name()), scene);
                    }
                }
            }
            Self::Scenes => {
                for named in named_scenes() {
                    let mut scene = named.scene()?;
                    // Converged frames are those of a cloth that stays as it is.
                    if scene.events.is_empty() {
                        scene.regrid(with_rows(grid.h, scene.grid))?;
                        push(named.name.to_owned(), scene);
                    }
                }
                return Ok(cases);
            }
        }
        cases.iter_mut().try_for_each(|case| case.scene.regrid(grid))?;
        Ok(cases)
    }
}

/// Returns the grid with this many rows whose proportions are nearest to those of `grid`.
fn with_rows(rows: usize, grid: Grid) -> Grid {
    Grid { h: rows, w: (rows * grid.w + grid.h / 2) / grid.h }
}

/// A case prepared for any number of solvers.
pub struct Prepared {
    case: Case,
    /// The scene and its number of frames, for [`Conditions`].
    settings: serde_json::Value,
    /// The scene in grid units.
    pub setup: Setup,
    /// The converged frames, computed when the first gap is measured.
    track: OnceCell<Track>,
}

impl Prepared {
    /// Prepares a case, for at most `frames` frames, including the start.
    pub fn new(case: Case, frames: usize) -> Result<Self> {
        let mut setup = case.scene.setup()?;
        if setup.frames() > frames {
            setup = Scene { frames: Some(frames), ..case.scene.clone() }.setup()?;
        }
        let settings = serde_json::json!({ "scene": case.scene.to_json(), "frames": setup.frames() });
        Ok(Self { case, settings, setup, track: OnceCell::new() })
    }

    /// Takes over the converged frames of the case before if they are those of this one, as in
    /// [`Suite::Iterations`].
    pub fn after(mut self, before: Self) -> Self {
        if self.settings == before.settings {
            self.track = before.track;
        }
        self
    }

    fn entry(&self, (optimizer, iterations): (&Optimizer, usize)) -> Entry {
        let iterations = self.case.iterations.unwrap_or(iterations);
        Entry { name: optimizer.name().into(), optimizer: optimizer.clone(), iterations, coarse: false }
    }

    /// Returns a name that identifies a solver's score in this case: the solver, its iterations, the grid and
    /// the case.
    pub fn name(&self, solver: &str, iterations: usize) -> String {
        let iterations = self.case.iterations.unwrap_or(iterations);
        format!("{solver}_{iterations}_{}_{}", self.setup.model.grid, self.case.name)
    }

    /// Returns the conditions of a score of [`Prepared::run`], apart from the iterations.
    pub fn conditions(&self, optimizer: &Optimizer, device: &Device, with_gap: bool) -> Conditions {
        let mut settings = self.settings.clone();
        settings["gap"] = with_gap.into();
        Conditions::of_scene(settings, &self.entry((optimizer, 1)), device)
    }

    /// Runs a solver, on the CPU if it has no GPU implementation, and measures its energy gap if that is
    /// requested. Returns `None` if `tick`, which is called in each frame, ended the run.
    pub fn run(
        &self,
        solver: (&Optimizer, usize),
        device: &Device,
        with_gap: bool,
        mut tick: impl FnMut() -> ControlFlow<()>,
    ) -> Result<Option<(CaseScore, Trajectory)>> {
        let (case, setup) = (&self.case, &self.setup);
        let (entry, made_with) = (self.entry(solver), self.conditions(solver.0, device, with_gap));
        let device = entry.device(device);
        let simulated = simulate(setup, &entry, device, &mut tick)?;
        if simulated.ended_early {
            return Ok(None);
        }
        let mut found = None;
        if with_gap {
            let Some(track) = self.track(&mut tick)? else { return Ok(None) };
            found = timed_gap(track, (solver.0, entry.iterations), device, tick)?;
            if found.is_none() {
                return Ok(None);
            }
        }
        let score = CaseScore {
            case: case.name.clone(),
            grid: setup.model.grid.to_string(),
            iterations: entry.recorded_iterations(),
            stable: simulated.stable,
            verdict: simulated.verdict,
            gap: found.map(|gap| gap.median).filter(|gap| gap.is_finite()),
            gap_ms_per_frame: found.map(|gap| gap.ms_per_frame).filter(|ms| ms.is_finite()),
            ms_per_frame: simulated.ms_per_frame(),
            repulsion: simulated.stable.then(|| self.repulsion_of(&simulated.trajectory)).flatten(),
            made_with,
        };
        Ok(Some((score, simulated.trajectory)))
    }

    /// Measures how near the layers came to each other; `None` without a frame after the start.
    fn repulsion_of(&self, trajectory: &Trajectory) -> Option<[f64; 3]> {
        let Setup { model, units, .. } = &self.setup;
        let measure = LayerProximity::new(model.grid, units.length_m * (model.grid.h - 1) as f64);
        let wide =
            |frame: usize| trajectory.frame(frame).iter().map(|p| p.map(f64::from)).collect::<Vec<_>>();
        let of_frames: Vec<f64> =
            (1..trajectory.frames()).into_par_iter().map(|frame| measure.of(&wide(frame))).collect();
        (!of_frames.is_empty()).then(|| mean_and_fractions_above(&of_frames))
    }

    fn track(&self, tick: impl FnMut() -> ControlFlow<()>) -> Result<Option<&Track>> {
        if self.track.get().is_none() {
            let Some(followed) = track(&self.setup, tick)? else { return Ok(None) };
            self.track.set(followed).ok().expect("it was not set");
        }
        Ok(self.track.get())
    }
}

/// Builds the table of a suite: one row per case, then one for all cases that share a grid and a number of
/// iterations, with the number of sound ones, the largest stretch, and the medians of the energy gap and the
/// time. The table of [`Suite::Repulsion`] also shows how near the layers came to each other.
pub fn table(title: &str, suite: Suite, scores: &[CaseScore]) -> Table {
    let of_repulsion = match suite {
        Suite::Repulsion => &["repulsion", "share > 0.1", "share > 0.02"][..],
        _ => &[],
    };
    let columns = ["case", "grid", "N", "sound", "largest stretch [%]", "energy gap [%]", "ms/frame"];
    let mut groups: Vec<Vec<&CaseScore>> = Vec::new();
    for score in scores {
        let same = |group: &&mut Vec<&CaseScore>| {
            (&group[0].grid, group[0].iterations) == (&score.grid, score.iterations)
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(score),
            None => groups.push(vec![score]),
        }
    }
    groups.retain(|group| group.len() > 1);
    Table {
        title: title.to_owned(),
        columns: columns.iter().chain(of_repulsion).map(|&column| column.to_owned()).collect(),
        rows: scores
            .iter()
            .map(|score| (case_row(score), score.repulsion))
            .chain(groups.iter().map(|group| (row_of_all(group), None)))
            .map(|((name, mut cells), repulsion)| {
                let text = |k: usize| repulsion.map_or_else(String::new, |all| format!("{:.3}", all[k]));
                cells.extend((0..of_repulsion.len()).map(|k| Cell { text: text(k), best: false }));
                (name, cells)
            })
            .collect(),
    }
}

fn case_row(score: &CaseScore) -> (String, Vec<Cell>) {
    let sound = match (score.stable, score.verdict.faults().first()) {
        (false, _) => "diverged",
        (true, None) => "yes",
        (true, Some(Fault::Stretch(_) | Fault::HeldStretch(_))) => "stretched",
        (true, Some(Fault::Gap(_))) => "far from minimum",
        (true, Some(Fault::Unconverged { .. })) => "not converged",
    };
    let stretch = Some(score.verdict.stretch_largest_free.unwrap_or(f64::INFINITY));
    let figures = [stretch, score.measured_gap(), score.ms_per_frame];
    row(score.case.clone(), score, sound.to_owned(), figures)
}

fn row_of_all(scores: &[&CaseScore]) -> (String, Vec<Cell>) {
    let sound = scores.iter().filter(|score| score.sound()).count();
    let stretch = |score: &&CaseScore| score.verdict.stretch_largest_free.unwrap_or(f64::INFINITY);
    let largest = scores.iter().map(stretch).fold(0.0, f64::max);
    let figures: [fn(&CaseScore) -> Option<f64>; 2] = [CaseScore::measured_gap, |score| score.ms_per_frame];
    // `None` if one case has none.
    let [gap, ms] = figures.map(|figure| {
        let all: Option<Vec<f64>> = scores.iter().map(|score| figure(score)).collect();
        all.map(|all| median(&all))
    });
    let name = format!("all {}", scores.len());
    row(name, scores[0], format!("{sound} of {}", scores.len()), [Some(largest), gap, ms])
}

/// Builds a row with the largest stretch, the energy gap and the time of a frame; grid and iterations are
/// those of `like`.
fn row(
    name: String,
    like: &CaseScore,
    sound: String,
    [stretch, gap, ms]: [Option<f64>; 3],
) -> (String, Vec<Cell>) {
    let percent = |share: f64, digits: usize| match share.is_finite() {
        true => format!("{:.digits$}", 100.0 * share),
        false => DIVERGED.to_owned(),
    };
    let cells = [
        like.grid.clone(),
        Some(like.iterations).filter(|&n| n > 0).map_or_else(String::new, |n| n.to_string()),
        sound,
        stretch.map_or_else(String::new, |stretch| percent(stretch, 1)),
        gap.map_or_else(String::new, |gap| percent(gap, 2)),
        ms.map_or_else(String::new, |ms| format!("{ms:.1}")),
    ];
    (name, cells.map(|text| Cell { text, best: false }).to_vec())
}
