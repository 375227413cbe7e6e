//! The check for each kind of golden file, and its tolerances.

use super::checker::{Checker, NETWORK, largest_error};
use super::cpu::CpuStages;
use super::golden::Golden;
use super::{
    AdamWCase, Check, EnergyCase, NetworkOutput, Precision, RolloutCase, Stages, TrainingCase, UpdateCase,
    Verdict,
};
use crate::cloth::{Cloth, Grid, Material, Repulsion};
use crate::eval::repulsion;
use crate::io::entries;
use crate::network::{Checkpoint, Weights};
use crate::{Error, Result};
use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;

/// Energies in double precision, relative.
const ENERGY_DOUBLE: f64 = 1e-9;
/// Energies in single precision, relative.
const ENERGY_SINGLE: f64 = 1e-5;
/// Gradients in single precision, in norm.
const GRADIENT_SINGLE: f64 = 1e-4;
/// Gradients in single precision, in norm, if edges are far from their rest length and angles near 0 and pi.
const GRADIENT_CRUMPLED: f64 = 1e-3;
/// Loss of a training step, relative.
const LOSS: f64 = 1e-4;
/// Gradient of a training step over the numbers of one weight, in norm.
const WEIGHT_GRADIENT: f64 = 1e-3;
/// Weights after steps of AdamW, relative to the largest.
const ADAMW: f64 = 1e-6;
/// Norm to which the gradients of the AdamW files are clipped.
const ADAMW_CLIP: f64 = 0.05;
/// Learning rate of the AdamW files.
const ADAMW_RATE: f64 = 1e-3;
/// First frame of a rollout, absolute in grid units.
const ROLLOUT_FIRST: f64 = 1e-4;
/// Growth of a rollout's tolerance per frame: from 1e-4 in the first frame to 1e-2 in the tenth, or more if
/// rounding takes a recording further.
///
/// A recorded rollout is itself in single precision: positions are rounded in each of the N iterations of a
/// frame, and the motion is chaotic. The effect of one rounding is measured for each array, by moving the
/// coordinates of the start by half their last bit. A rollout may be off by N times that.
const DRIFT: f64 = 1.668_100_537_200_059;
/// How often that effect is measured, each time with other coordinates moved up and others down. It is a matter of
/// chance: a single measurement is as often too small as too large.
const NUDGES: u32 = 4;

/// Returns the name of the weights of a rollout: "rollout_starter_32x32_seed5" belongs to "starter", what stands
/// before the grid.
fn checkpoint_of(rollout: &str) -> String {
    let is_grid = |word: &&str| {
        word.split_once('x').is_some_and(|(h, w)| [h, w].iter().all(|side| side.parse::<usize>().is_ok()))
    };
    let words = rollout.trim_start_matches("rollout_").split('_');
    words.take_while(|word| !is_grid(word)).collect::<Vec<_>>().join("_")
}

/// Returns a file's name without its extension.
fn stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Checks every golden file of `folder` on `stages`, and passes the result for each array to `report`.
/// Returns an error only if the folder cannot be read or contains no golden file. Damaged files count as
/// failed checks; files with other names are skipped.
pub fn verify_folder(folder: &Path, stages: &mut dyn Stages, report: &mut dyn FnMut(Check)) -> Result<()> {
    let mut files = entries(folder)?;
    files.retain(|path| path.extension().is_some_and(|e| e == "safetensors"));
    let kinds = Checker::KINDS.map(|(prefix, _)| prefix);
    if !files.iter().any(|path| kinds.iter().any(|kind| stem(path).starts_with(kind))) {
        let expected = format!("golden files ({}*.safetensors)", kinds.join("*, "));
        let found = match files.len() {
            0 => "none".to_owned(),
            count => format!("{count} files with other names, such as {}", stem(&files[0])),
        };
        return Err(Error::invalid(folder.display().to_string(), "folder", expected, found));
    }
    for path in files {
        let file = stem(&path);
        let mut checker = Checker { file: &file, folder, stages, report };
        if let Err(error) = checker.file(&path) {
            checker.verdict(&error.to_string(), Verdict::Failed);
        }
    }
    Ok(())
}

/// A check of the arrays of a golden file.
type ArrayCheck<C> = fn(&mut C, &Golden) -> Result<()>;

impl Checker<'_> {
    /// The kinds of golden files, by the beginning of their names, with the check of their arrays. Weights are
    /// only loaded.
    const KINDS: [(&'static str, Option<ArrayCheck<Self>>); 9] = [
        ("network_forward", Some(Self::network)),
        ("network_weights", None),
        ("checkpoint_", None),
        ("update_rule", Some(Self::update)),
        ("energy_", Some(Self::energy)),
        ("rollout_", Some(Self::rollout)),
        ("training_step", Some(Self::training_step)),
        ("adamw", Some(Self::adamw)),
        ("repulsion_", Some(Self::repulsion)),
    ];

    fn file(&mut self, path: &Path) -> Result<()> {
        match Self::KINDS.iter().find(|(prefix, _)| self.file.starts_with(prefix)) {
            Some((_, Some(check))) => return self.arrays(path, *check),
            Some((_, None)) => {
                let weights = Weights::load(path)?;
                self.verdict(&format!("{} parameters", weights.parameter_count()), Verdict::Passed);
            }
            None => {
                let known = Self::KINDS.map(|(prefix, _)| prefix);
                let error = Error::unknown("name", "kind of golden file", self.file, known);
                self.verdict(&error.to_string(), Verdict::Skipped);
            }
        }
        Ok(())
    }

    /// Checks a file's arrays, and reports any that the check did not read.
    fn arrays(&mut self, path: &Path, check: ArrayCheck<Self>) -> Result<()> {
        let golden = Golden::open(path)?;
        check(self, &golden)?;
        for name in golden.unread() {
            self.verdict(&format!("{name}: unexpected array"), Verdict::Skipped);
        }
        Ok(())
    }

    fn network(&mut self, golden: &Golden) -> Result<()> {
        let [samples, fields, h, w] = golden.shape("input")?;
        let weights = self.weights("network_weights")?;
        if fields != weights.config.fields {
            let expected = format!("{} fields", weights.config.fields);
            return Err(Error::invalid(self.file, "input", expected, fields));
        }
        let grid = Grid::new(h, w, self.file)?;
        let input = golden.shaped("input", &[samples, fields, h, w])?;
        let NetworkOutput { embedded, lifted, blocks, field, scalar } =
            self.stages.network(&weights, grid, input)?;
        let channels = [samples, weights.config.channels, h, w];
        self.optional(golden, "embedded", &[samples, fields + 2, h, w], &embedded)?;
        self.optional(golden, "lifted", &channels, &lifted)?;
        for (i, block) in blocks.iter().enumerate() {
            self.optional(golden, &format!("block{i}"), &channels, block)?;
        }
        self.network_magnitude("field", golden.shaped("field", &[samples, 1, h, w])?, &field);
        self.network_magnitude("scalar", golden.shaped("scalar", &[samples, 1])?, &scalar);
        Ok(())
    }

    fn update(&mut self, golden: &Golden) -> Result<()> {
        let [samples, _, h, w] = golden.shape("grads")?;
        let (grid, shape) = (Grid::new(h, w, self.file)?, [samples, 1, h, w]);
        let per_sample = [samples, 1, 1, 1];
        let weights = self.weights("network_weights")?;
        let mut case = UpdateCase {
            grid,
            grad: golden.shaped("grads", &shape)?.to_vec(),
            last_grad: golden.shaped("last_grads", &shape)?.to_vec(),
            last_step: golden.shaped("last_steps", &shape)?.to_vec(),
            scale: golden.shaped("scales", &per_sample)?.to_vec(),
        };
        let (step, scales) = self.stages.update(&weights, &case)?;
        self.network_magnitude("step", golden.shaped("step", &shape)?, &step);
        self.network_magnitude("new_scales", golden.shaped("new_scales", &per_sample)?, &scales);
        case.last_grad.fill(0.0);
        case.last_step.fill(0.0);
        case.scale.fill(crate::sim::INITIAL_SCALE.into());
        let (step, scales) = self.stages.update(&weights, &case)?;
        let name = "step_from_fresh_state";
        self.network_magnitude(name, golden.shaped(name, &shape)?, &step);
        let name = "new_scales_from_fresh_state";
        self.network_magnitude(name, golden.shaped(name, &per_sample)?, &scales);
        Ok(())
    }

    fn training_step(&mut self, golden: &Golden) -> Result<()> {
        let [batch, _, h, w] = golden.shape("positions")?;
        let grid = Grid::new(h, w, self.file)?;
        let [shape, samples] = [[batch, 3, h, w], [3 * batch, 1, h, w]];
        if self.stages.precision() == Precision::Half {
            self.verdict("training needs 32-bit storage", Verdict::Skipped);
            golden.mark_read("");
            return Ok(());
        }
        let weights = self.weights("network_weights")?;
        let field = |name: &str, shape: &[usize]| Ok::<_, Error>(golden.shaped(name, shape)?.to_vec());
        let cloths = cloths(golden, batch, grid)?;
        let (n, targets) = (h * w, field("handle_positions", &shape)?);
        let handles =
            cloths.iter().enumerate().flat_map(|(b, c)| c.handles.iter().map(move |p| 3 * n * b + p));
        let case = TrainingCase {
            grid,
            targets: handles.map(|at| [0, 1, 2].map(|k| targets[at + k * n])).collect(),
            cloths,
            x: field("positions", &shape)?,
            v: field("velocities", &shape)?,
            a: field("accelerations", &shape)?,
            external: field("external_accelerations", &shape)?,
            last_grad: field("last_grads", &samples)?,
            last_step: field("last_steps", &samples)?,
            scale: field("scales", &[3 * batch, 1, 1, 1])?,
        };
        let expected = Checkpoint::open(golden.path())?.part("gradient.").weights()?;
        golden.mark_read("gradient.");
        if expected.config != weights.config {
            let (wanted, found) = (format!("{:?}", weights.config), format!("{:?}", expected.config));
            return Err(Error::invalid(self.file, "gradient.*", wanted, found));
        }
        self.mass(golden, grid)?;
        let at = EnergyCase {
            grid,
            cloths: case.cloths.clone(),
            base: base(golden, &shape)?,
            x: case.x.clone(),
            a: case.a.clone(),
            external: case.external.clone(),
        };
        let (_, grad) = self.stages.energy(&at)?;
        self.in_norm("grads", golden.shaped("grads", &samples)?, &grad, GRADIENT_SINGLE);
        let found = self.stages.training_step(&weights, &case)?;
        self.magnitude("loss", golden.shaped("loss", &[])?, &[found.loss], LOSS);
        self.magnitude("step", golden.shaped("step", &samples)?, &found.step, NETWORK);
        let mut rest = &found.gradient[..];
        for (name, expected) in expected.parameter_names().iter().zip(expected.parameters()) {
            let (gradient, others) = rest.split_at(expected.len());
            let expected: Vec<f64> = expected.iter().map(|&v| v.into()).collect();
            self.in_norm(&format!("gradient.{name}"), &expected, gradient, WEIGHT_GRADIENT);
            rest = others;
        }
        let norm = found.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        self.magnitude("gradient_norm", golden.shaped("gradient_norm", &[])?, &[norm], WEIGHT_GRADIENT);
        Ok(())
    }

    /// Checks the particle masses, if the file contains them, against those of the grid.
    fn mass(&mut self, golden: &Golden, grid: Grid) -> Result<()> {
        let found: Vec<f64> = (0..grid.particles()).map(|p| grid.mass(p / grid.w, p % grid.w)).collect();
        if golden.has("mass") {
            self.magnitude("mass", golden.shaped("mass", &[1, 1, grid.h, grid.w])?, &found, ENERGY_DOUBLE);
        }
        Ok(())
    }

    fn adamw(&mut self, golden: &Golden) -> Result<()> {
        let names: Vec<&str> = golden.names().filter_map(|n| n.strip_prefix("before.")).collect();
        if names.is_empty() {
            return Err(Error::invalid(self.file, "before.*", "weights", "none"));
        }
        // All arrays are concatenated, because clipping uses the norm over all of them.
        let concatenated = |prefix: &str| -> Result<Vec<f64>> {
            let mut all = Vec::new();
            for name in &names {
                let (shape, _) = golden.array(&format!("before.{name}"))?;
                all.extend_from_slice(golden.shaped(&format!("{prefix}.{name}"), shape)?);
            }
            Ok(all)
        };
        let before = concatenated("before")?;
        let of_step = |k: usize| {
            let has = |name: &&str| {
                golden.has(&format!("grad{k}.{name}")) || golden.has(&format!("after{k}.{name}"))
            };
            names.iter().any(has)
        };
        let steps = (0..).take_while(|&k| of_step(k)).count();
        if before.is_empty() || steps == 0 {
            let (expected, found) = ("weights, and gradients of a step", format!("{steps} steps"));
            return Err(Error::invalid(self.file, "before.*, grad0.*", expected, found));
        }
        let gradients = (0..steps).map(|k| concatenated(&format!("grad{k}"))).collect::<Result<_>>()?;
        let case = AdamWCase { before, gradients, clip: ADAMW_CLIP, rate: ADAMW_RATE };
        let found = self.stages.adamw(&case)?;
        for (k, found) in found.iter().enumerate() {
            let mut rest = &found[..];
            for name in &names {
                let (shape, before) = golden.array(&format!("before.{name}"))?;
                let (found, others) = rest.split_at(before.len());
                let name = format!("after{k}.{name}");
                self.magnitude(&name, golden.shaped(&name, shape)?, found, ADAMW);
                rest = others;
            }
        }
        Ok(())
    }

    fn energy(&mut self, golden: &Golden) -> Result<()> {
        let [batch, _, h, w] = golden.shape("positions")?;
        let (grid, shape) = (self.grid_with_cells(h, w)?, [batch, 3, h, w]);
        let field = |name: &str| golden.shaped(name, &shape);
        let case = EnergyCase {
            grid,
            cloths: cloths(golden, batch, grid)?,
            x: field("positions")?.to_vec(),
            base: base(golden, &shape)?,
            a: field("accelerations")?.to_vec(),
            external: field("external_accelerations")?.to_vec(),
        };
        self.mass(golden, grid)?;
        let (terms, grad) = self.stages.energy(&case)?;
        let precision = self.stages.precision();
        let tolerance = match precision {
            Precision::Double => ENERGY_DOUBLE,
            Precision::Single | Precision::Half => ENERGY_SINGLE,
        };
        let named = [
            ("stretching_energy", terms.iter().map(|t| t.stretch).collect::<Vec<_>>()),
            ("shearing_energy", terms.iter().map(|t| t.shear).collect()),
            ("bending_energy", terms.iter().map(|t| t.bend).collect()),
            ("inertia", terms.iter().map(|t| t.inertia).collect()),
            ("external", terms.iter().map(|t| t.external).collect()),
            ("total", terms.iter().map(|t| t.total()).collect()),
        ];
        for (name, found) in named {
            self.magnitude(name, golden.shaped(name, &[batch])?, &found, tolerance);
        }
        let tolerance = match precision {
            Precision::Double => ENERGY_DOUBLE,
            Precision::Single | Precision::Half if self.file.contains("crumpled") => GRADIENT_CRUMPLED,
            Precision::Single | Precision::Half => GRADIENT_SINGLE,
        };
        self.in_norm("gradient", field("gradient")?, &grad, tolerance);
        Ok(())
    }

    fn rollout(&mut self, golden: &Golden) -> Result<()> {
        if self.stages.precision() == Precision::Half {
            self.verdict("not comparable in 16 bits: the motion is chaotic", Verdict::Skipped);
            golden.mark_read("");
            return Ok(());
        }
        let [frames, _, h, w] = golden.shape("positions")?;
        let [_, handles, _] = golden.shape("handle_targets")?;
        let [rows, _] = golden.shape("gradient_norms")?;
        let (grid, shape) = (Grid::new(h, w, self.file)?, [frames, 3, h, w]);
        if handles > 2 {
            return Err(Error::invalid(
                self.file,
                "handle_targets",
                "the two corners or one of them",
                handles,
            ));
        }
        if !rows.is_multiple_of(frames) {
            let expected = format!("a multiple of {frames} rows, one set per frame");
            return Err(Error::invalid(self.file, "gradient_norms", expected, rows));
        }
        let weights = Arc::new(self.weights(&format!("checkpoint_{}", checkpoint_of(self.file)))?);
        let material = golden.shaped("material", &[3])?;
        let gravity = golden.shaped("external_acceleration", &[3])?;
        let targets = golden.shaped("handle_targets", &[frames, handles, 3])?;
        let case = RolloutCase {
            grid,
            cloth: Cloth {
                material: Material {
                    stretch: material[0],
                    shear: material[1],
                    bend: material[2],
                    ..Material::PAPER
                },
                gravity: [gravity[0], gravity[1], gravity[2]],
                handles: [0, (h - 1) * w].into_iter().take(handles).collect(),
                ..Cloth::default()
            },
            iterations: rows / frames,
            start: golden.shaped("start", &[3, h, w])?.to_vec(),
            targets: targets
                .chunks_exact(3 * handles)
                .map(|f| f.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect())
                .collect(),
        };
        let found = self.stages.rollout(&weights, &case)?;
        let exact = CpuStages::<f64>::new().rollout(&weights, &case)?;
        let rounded = |seed| {
            let nudged = RolloutCase { start: nudged(&case.start, seed), ..case.clone() };
            CpuStages::<f64>::new().rollout(&weights, &nudged)
        };
        let rounded = (1..=NUDGES).map(rounded).collect::<Result<Vec<_>>>()?;
        type Part = fn(&super::RolloutFrame) -> &[f64];
        let arrays: [(&str, Vec<usize>, Part); 5] = [
            ("positions", shape.to_vec(), |f| &f.x),
            ("velocities", shape.to_vec(), |f| &f.v),
            ("accelerations", shape.to_vec(), |f| &f.a),
            ("scales", vec![rows, 3], |f| &f.scales),
            ("gradient_norms", vec![rows, 3], |f| &f.gradient_norms),
        ];
        for (name, shape, part) in arrays {
            let expected = golden.shaped(name, &shape)?;
            // Rounding is random: a frame may be off by the largest effect up to that frame.
            let mut rounding = 0.0_f64;
            let frame = |(k, expected): (usize, &[f64])| {
                for rounded in &rounded {
                    rounding = rounding.max(largest_error(part(&exact[k]), part(&rounded[k])));
                }
                // If the exact rollout is not finite, there is nothing to compare with.
                let tolerance = match rounding.is_finite() {
                    true => (ROLLOUT_FIRST * DRIFT.powi(k as i32)).max(case.iterations as f64 * rounding),
                    false => f64::NAN,
                };
                (k + 1, largest_error(expected, part(&found[k])), tolerance)
            };
            // One line per array: the frame that comes closest to its tolerance.
            let chunks = expected.chunks_exact(expected.len() / frames).enumerate();
            let closest = chunks.map(frame).max_by(|a, b| (a.1 / a.2).total_cmp(&(b.1 / b.2)));
            let (k, error, tolerance) = closest.expect("a rollout has frames");
            self.compared(&format!("{name} (frame {k})"), (error, error), tolerance);
        }
        Ok(())
    }

    /// Checks the repulsion at the file's positions, with lambda = 1. The file's energy is the paper's, which is
    /// not 0 where a pair comes into range ([`EnergyTerms::repulsion`](crate::cloth::EnergyTerms::repulsion)): ours
    /// is expected to be higher by the same amount for each pair.
    fn repulsion(&mut self, golden: &Golden) -> Result<()> {
        let [_, h, w] = golden.shape("positions")?;
        let grid = self.grid_with_cells(h, w)?;
        let (x, n) = (golden.shaped("positions", &[3, h, w])?, grid.particles());
        let distance = golden.shaped("threshold", &[])?[0];
        if distance <= 0.0 {
            return Err(Error::invalid(self.file, "threshold", "a distance above 0", distance));
        }
        let (expected, of_grad) = (golden.shaped("energy", &[])?, golden.shaped("gradient", &[3, h, w])?);
        let points: Vec<[f64; 3]> = (0..n).map(|p| [x[p], x[n + p], x[2 * n + p]]).collect();
        // The measure of an evaluation is the paper's. It is computed on the host, in double precision.
        if self.stages.precision() == Precision::Double {
            let measured = repulsion(&points, &grid.faces(), distance);
            self.magnitude("energy (measure)", expected, &[measured], ENERGY_DOUBLE);
        }
        let lambda_1 = Repulsion { strength: n as f64, distance };
        let (energy, grad) = self.stages.repulsion(grid, x, lambda_1)?;
        let [of_energy, in_norm] = match self.stages.precision() {
            Precision::Double => [ENERGY_DOUBLE; 2],
            Precision::Single | Precision::Half => [ENERGY_SINGLE, GRADIENT_SINGLE],
        };
        let pairs = pairs_in_range(&points, &grid.faces(), distance) as f64;
        let expected = expected[0] + pairs * (distance * distance + Repulsion::SOFTENING).ln();
        self.magnitude("energy", &[expected], &[energy], of_energy);
        self.in_norm("gradient", of_grad, &grad, in_norm);
        Ok(())
    }
}

/// Returns the number of ordered pairs of particles closer than `distance` that no edge of a face joins, by looking
/// at all of them.
fn pairs_in_range(points: &[[f64; 3]], faces: &[[u32; 3]], distance: f64) -> usize {
    let edges = faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let joined: HashSet<(u32, u32)> = edges.flat_map(|(p, q)| [(p, q), (q, p)]).collect();
    let is_near = |p: &[f64; 3], q: &[f64; 3]| {
        (0..3).map(|c| (p[c] - q[c]) * (p[c] - q[c])).sum::<f64>() < distance * distance
    };
    let of = |(p, own): (usize, &[f64; 3])| {
        let others = points.iter().enumerate().filter(move |&(q, _)| q != p);
        others.filter(|(q, other)| is_near(own, other) && !joined.contains(&(p as u32, *q as u32))).count()
    };
    points.iter().enumerate().map(of).sum()
}

/// Returns the displacements of a batch without acceleration, [B, 3, H, W]: a particle's velocity, or
/// for a handle the displacement to its target.
fn base(golden: &Golden, shape: &[usize; 4]) -> Result<Vec<f64>> {
    let &[batch, _, h, w] = shape;
    let n = h * w;
    let mask = golden.shaped("handle_mask", &[batch, 1, h, w])?;
    let [x, v, targets] =
        ["positions", "velocities", "handle_positions"].map(|name| golden.shaped(name, shape));
    let (x, v, targets) = (x?, v?, targets?);
    let is_handle = |k: usize| mask[k / (3 * n) * n + k % n] != 0.0;
    Ok((0..x.len()).map(|k| if is_handle(k) { targets[k] - x[k] } else { v[k] }).collect())
}

/// Returns the cloths of a batch with their materials and handles.
fn cloths(golden: &Golden, batch: usize, grid: Grid) -> Result<Vec<Cloth>> {
    let n = grid.particles();
    let mask = golden.shaped("handle_mask", &[batch, 1, grid.h, grid.w])?;
    let coefficient = |name: &str| golden.shaped(name, &[batch]);
    let (stretch, shear, bend) =
        (coefficient("stretching")?, coefficient("shearing")?, coefficient("bending")?);
    let cloth = |b: usize| Cloth {
        material: Material { stretch: stretch[b], shear: shear[b], bend: bend[b], ..Material::PAPER },
        handles: (0..n).filter(|p| mask[b * n + p] != 0.0).collect(),
        ..Cloth::default()
    };
    Ok((0..batch).map(cloth).collect())
}

/// Moves each coordinate by half the spacing of single-precision numbers, up or down by a pseudo-random choice that
/// depends on the seed alone, which is not 0.
fn nudged(x: &[f64], seed: u32) -> Vec<f64> {
    let mut bits = seed.wrapping_mul(0x9e37_79b9);
    x.iter()
        .map(|&x| {
            // xorshift32
            bits ^= bits << 13;
            bits ^= bits >> 17;
            bits ^= bits << 5;
            let half = 0.5 * f64::from((x as f32).next_up() - x as f32);
            if bits & 1 == 0 { x + half } else { x - half }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::Finding;
    use super::*;
    use safetensors::tensor::{Dtype, TensorView, serialize_to_file};

    /// Writes a file of arrays that are `value` everywhere, and returns why it fails.
    fn failure(name: &str, arrays: &[(&str, &[usize])], value: f32) -> String {
        let folder = tempfile::tempdir().unwrap();
        let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
        let needed = match name.split('_').next() {
            Some("rollout") => "checkpoint_starter.safetensors",
            _ => "network_weights.safetensors",
        };
        std::fs::copy(golden.join(needed), folder.path().join(needed)).unwrap();
        let bytes = |shape: &[usize]| value.to_le_bytes().repeat(shape.iter().product());
        let data: Vec<_> = arrays.iter().map(|(name, shape)| (*name, shape.to_vec(), bytes(shape))).collect();
        let view = |(name, shape, bytes)| (name, TensorView::new(Dtype::F32, shape, bytes).unwrap());
        let views = data.iter().map(|(name, shape, bytes)| view((*name, shape.clone(), &bytes[..])));
        serialize_to_file(views, None, &folder.path().join(name).with_extension("safetensors")).unwrap();
        let mut failed = Vec::new();
        verify_folder(folder.path(), &mut CpuStages::<f32>::new(), &mut |check| {
            if let (Verdict::Failed, Finding::Message { message }) = (check.outcome, check.finding) {
                failed.push(message);
            }
        })
        .unwrap();
        failed.join("\n")
    }

    #[test]
    fn the_weights_of_a_rollout_are_named_before_its_grid() {
        assert_eq!(checkpoint_of("rollout_starter_32x32"), "starter");
        assert_eq!(checkpoint_of("rollout_my_best_24x32_seed5"), "my_best");
        assert_eq!(checkpoint_of("rollout_10xlarger"), "10xlarger");
    }

    #[test]
    fn files_of_wrong_shapes_and_counts_are_failed_checks() {
        let energy = |three, h, w| -> String {
            let state = [1, three, h, w];
            let names = ["positions", "velocities", "accelerations", "handle_positions", "gradient"];
            let mut arrays: Vec<(&str, &[usize])> = names.map(|name| (name, &state[..])).to_vec();
            arrays.push(("external_accelerations", &state));
            let mask = [1, 1, h, w];
            arrays.push(("handle_mask", &mask));
            arrays.extend(["stretching", "shearing", "bending"].map(|name| (name, &[1][..])));
            failure("energy_x", &arrays, 1.0)
        };
        assert!(energy(4, 5, 5).contains("positions: expected shape [1, 3, 5, 5], found [1, 4, 5, 5]"));
        assert!(energy(3, 1, 5).contains("at least two particles per side, found 1x5"));
        // The smallest grid has an energy, but this file has nothing to compare it with.
        assert!(energy(3, 2, 2).contains("stretching_energy: expected an array of that name"));

        let fields = ["grads", "last_grads", "last_steps", "step"].map(|name| (name, &[3, 2, 8, 8][..]));
        let scales = ["scales", "new_scales"].map(|name| (name, &[3, 1, 1, 1][..]));
        let message = failure("update_rule_x", &[&fields[..], &scales].concat(), 0.5);
        assert!(message.contains("grads: expected shape [3, 1, 8, 8]"), "{message}");

        let rollout = |three, handles, rows| {
            let arrays: [(&str, &[usize]); 6] = [
                ("positions", &[4, three, 8, 8]),
                ("handle_targets", &[4, handles, 3]),
                ("gradient_norms", &[rows, 3]),
                ("material", &[3]),
                ("external_acceleration", &[3]),
                ("start", &[3, 8, 8]),
            ];
            failure("rollout_starter_8x8", &arrays, 1.0)
        };
        assert!(rollout(3, 3, 4).contains("handle_targets: expected the two corners"));
        assert!(rollout(3, 2, 3).contains("gradient_norms: expected a multiple of 4 rows"));
        assert!(rollout(3, 2, 5).contains("gradient_norms"));
        assert!(rollout(2, 2, 4).contains("positions: expected shape [4, 3, 8, 8]"));

        let repulsion = |h, value| {
            let (of, one): (&[usize], &[usize]) = (&[3, h, 8], &[]);
            failure("repulsion_x", &[("positions", of), ("threshold", one), ("energy", one)], value)
        };
        assert!(repulsion(1, 1.0).contains("at least two particles per side"));
        assert!(repulsion(8, f32::NAN).contains("finite numbers, found NaN"));
        assert!(repulsion(8, 0.0).contains("threshold: expected a distance above 0"));

        assert!(failure("adamw", &[("before.a", &[2])], 1.0).contains("grad0"));
        assert!(failure("network_forward_x", &[("input", &[1, 3, 2, 2])], 1.0).contains("8 to 4096"));
    }
}
