//! Reads and checks a configuration, field by field.

use super::config::{
    AdamWOptions, Config, Every, MaterialRanges, MotionRanges, PoolConfig, Range, ResetRules,
    ValidationConfig,
};
use super::schedule::{Decay, RateSchedule};
use crate::cloth::{Grid, MAX_GRID, MIN_GRID};
use crate::cpu::train::AdamWSettings;
use crate::io::{Node, parse_toml};
use crate::settings::Normalisation;
use crate::sim::INITIAL_SCALE;
use crate::{Error, Result, network};
use serde::{Serialize, Serializer};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Maximum number of particles in all pools; each takes 60 bytes.
const MAX_PARTICLES: usize = 1 << 28;
/// Maximum number of cloths in all pools.
const MAX_CLOTHS: usize = 1 << 20;
/// Maximum number of parameters of a network.
const MAX_PARAMETERS: usize = 1 << 28;
/// Maximum width of a layer.
const MAX_CHANNELS: usize = 4096;

/// Parses a configuration; see [`Config::parse`].
pub(super) fn config(text: &str, path: &Path) -> Result<Config> {
    let origin = path.display().to_string();
    let document = parse_toml(&origin, text)?;
    let root = Node::root(&origin, &document);
    root.deny_unknown(&[
        "notes",
        "seed",
        "steps",
        "log_every",
        "average",
        "normalisation",
        "init",
        "network",
        "pool",
        "motion",
        "reset",
        "optimizer",
        "schedule",
        "validation",
        "checkpoint",
    ])?;
    let base = Config::default();
    let resolved = |file: &Node<'_>| Ok(path.parent().unwrap_or(Path::new("")).join(file.text()?));
    let files = |n: &Node<'_>| match n.items() {
        Ok(several) => several.iter().map(resolved).collect(),
        Err(_) => Ok(vec![resolved(n)?]),
    };
    let config = Config {
        notes: root.get_or("notes", base.notes, |n| Ok(n.text()?.to_owned()))?,
        seed: root.get_or("seed", base.seed, whole)?,
        steps: root.get_or("steps", base.steps, above_zero)?,
        log_every: root.get_or("log_every", base.log_every, above_zero)?,
        average: root.get_or("average", base.average, decay)?,
        normalisation: root.get_or("normalisation", base.normalisation, normalisation)?,
        init: root.get_or("init", base.init, files)?,
        network: root.get_or("network", base.network, network)?,
        pools: root.get_or("pool", base.pools, |n| n.items()?.iter().map(pool).collect())?,
        motion: root.get_or("motion", base.motion, motion)?,
        reset: root.get_or("reset", base.reset, reset)?,
        optimizer: root.get_or("optimizer", base.optimizer, optimizer)?,
        schedule: root.get_or("schedule", base.schedule, schedule)?,
        validation: root.get_or("validation", base.validation, validation)?,
        checkpoint: root.get_or("checkpoint", base.checkpoint, |n| {
            n.deny_unknown(&["every"])?;
            n.get_or("every", base.checkpoint, every)
        })?,
    };
    check(config, &origin)
}

/// Returns the text of the configuration file `path` with the paths of `init` made absolute and all else
/// unchanged.
pub(super) fn absolute_paths(mut text: String, path: &Path) -> Result<String> {
    let origin = path.display().to_string();
    let folder = path.parent().unwrap_or(Path::new("")).join(".");
    // Canonicalize, so that the result does not depend on how the file was reached.
    let folder = folder.canonicalize().map_err(|e| Error::io(&folder, "cannot find", e))?;
    let document = DeTable::parse(&text).map_err(|e| Error::invalid(&origin, "text", "TOML", e.message()))?;
    let mut files = Vec::new();
    let mut file = |value: &Spanned<DeValue<'_>>| {
        files.extend(value.get_ref().as_str().map(|name| (value.span(), folder.join(name))));
    };
    if let Some(init) = document.get_ref().get("init") {
        match init.get_ref() {
            DeValue::Array(several) => several.iter().for_each(file),
            _ => file(init),
        }
    }
    // Replace from last to first, so that the remaining spans stay valid.
    for (place, path) in files.into_iter().rev() {
        let name = path
            .to_str()
            .ok_or_else(|| Error::invalid(&origin, "init", "a folder whose name is UTF-8", path.display()))?;
        text.replace_range(place, &quoted(name));
    }
    Ok(text)
}

/// Returns a text as a TOML basic string.
fn quoted(text: &str) -> String {
    let escaped = |c: char| match c {
        '"' | '\\' => format!("\\{c}"),
        c if c.is_control() => format!("\\u{:04X}", u32::from(c)),
        c => c.to_string(),
    };
    format!("\"{}\"", text.chars().map(escaped).collect::<String>())
}

/// Checks the conditions that involve several fields.
fn check(config: Config, origin: &str) -> Result<Config> {
    if config.pools.is_empty() {
        return Err(Error::invalid(origin, "pool", "at least one", "none"));
    }
    if config.pools.iter().all(|pool| pool.every > 1) {
        return Err(Error::invalid(
            origin,
            "pool",
            "at least one with every = 1, so that every step draws cloths",
            "none",
        ));
    }
    let particles: usize = config.pools.iter().map(|p| p.cloths * p.grid.particles()).sum();
    if particles > MAX_PARTICLES {
        let expected = format!("at most {MAX_PARTICLES} particles in all pools");
        return Err(Error::invalid(origin, "pool", expected, particles));
    }
    // The progress of each cloth is stored in the header of a checkpoint.
    let cloths: usize = config.pools.iter().map(|p| p.cloths).sum();
    if cloths > MAX_CLOTHS {
        return Err(Error::invalid(
            origin,
            "pool",
            format!("at most {MAX_CLOTHS} cloths in all pools"),
            cloths,
        ));
    }
    let parameters = config.network.parameter_count();
    if parameters > MAX_PARAMETERS {
        let expected = format!("sizes that make at most {MAX_PARAMETERS} parameters");
        return Err(Error::invalid(origin, "network", expected, parameters));
    }
    let named = |name: String, grids: Vec<Grid>| grids.into_iter().map(move |grid| (name.clone(), grid));
    let pools =
        config.pools.iter().enumerate().flat_map(|(k, p)| named(format!("pool[{k}].grid"), vec![p.grid]));
    let grids = pools.chain(named("validation.grids".into(), config.validation.grids.clone()));
    for (field, grid) in grids {
        config.network.check_grid(grid, origin, &field)?;
    }
    if let Decay::Cosine { last } = config.schedule.decay
        && last > config.optimizer.rate
    {
        let expected = format!("at most the rate {}", config.optimizer.rate);
        return Err(Error::invalid(origin, "schedule.decay.cosine.final", expected, last));
    }
    if let Some([low, high]) = config.reset.scale
        && !(low..=high).contains(&f64::from(INITIAL_SCALE))
    {
        let expected = format!("a range around {INITIAL_SCALE}, with which cloths begin");
        return Err(Error::invalid(origin, "reset.scale", expected, format!("{low} to {high}")));
    }
    if config.schedule.warmup > config.steps {
        let expected = format!("at most the steps, {}", config.steps);
        return Err(Error::invalid(origin, "schedule.warmup", expected, config.schedule.warmup));
    }
    Ok(config)
}

fn network(node: &Node<'_>) -> Result<network::Config> {
    node.deny_unknown(&["lifting", "channels", "projection", "layers", "modes_h", "modes_w"])?;
    let base = network::Config::default();
    let size = |key, default, most| node.get_or(key, default, |n| count(n, 1, most));
    Ok(network::Config {
        lifting: size("lifting", base.lifting, MAX_CHANNELS)?,
        channels: size("channels", base.channels, MAX_CHANNELS)?,
        projection: size("projection", base.projection, MAX_CHANNELS)?,
        layers: size("layers", base.layers, 64)?,
        modes_h: size("modes_h", base.modes_h, MAX_GRID)?,
        modes_w: size("modes_w", base.modes_w, MAX_GRID)?,
        ..base
    })
}

fn pool(node: &Node<'_>) -> Result<PoolConfig> {
    node.deny_unknown(&[
        "grid",
        "iterations",
        "cloths",
        "batch",
        "material",
        "sequence_length",
        "corners",
        "every",
    ])?;
    let base = PoolConfig::default();
    let cloths = node.get_or("cloths", base.cloths, |n| count(n, 1, 1 << 24))?;
    Ok(PoolConfig {
        grid: node.get_or("grid", base.grid, grid)?,
        iterations: node.get_or("iterations", base.iterations as usize, |n| count(n, 1, 1 << 16))? as u32,
        cloths,
        batch: node.get_or("batch", base.batch.min(cloths), |n| count(n, 1, cloths))?,
        material: node.get_or("material", base.material, |n| {
            n.deny_unknown(&["stretch", "shear", "bend"])?;
            Ok(MaterialRanges {
                stretch: n.get_or("stretch", base.material.stretch, range)?,
                shear: n.get_or("shear", base.material.shear, range)?,
                bend: n.get_or("bend", base.material.bend, range)?,
            })
        })?,
        sequence_length: node.get_or("sequence_length", None, |n| above_zero(n).map(Some))?,
        corners: node.get_or("corners", None, |n| share(n).map(Some))?,
        every: node.get_or("every", base.every, above_zero)?,
    })
}

fn motion(node: &Node<'_>) -> Result<MotionRanges> {
    const SIZES: [&str; 4] = ["rotation", "amplitude", "frequency", "gravity"];
    const SHARES: [&str; 6] = ["moving", "pinch", "aligned", "corners", "more_handles", "damping"];
    node.deny_unknown(&[&SIZES[..], &SHARES].concat())?;
    let base = MotionRanges::default();
    let size = |key, default| node.get_or(key, default, Node::not_negative);
    Ok(MotionRanges {
        moving: node.get_or("moving", base.moving, share)?,
        rotation: size("rotation", base.rotation)?,
        amplitude: size("amplitude", base.amplitude)?,
        frequency: size("frequency", base.frequency)?,
        pinch: node.get_or("pinch", base.pinch, share)?,
        gravity: size("gravity", base.gravity)?,
        aligned: node.get_or("aligned", base.aligned, share)?,
        corners: node.get_or("corners", base.corners, share)?,
        more_handles: node.get_or("more_handles", base.more_handles, decay)?,
        damping: node.get_or("damping", base.damping, share)?,
    })
}

fn reset(node: &Node<'_>) -> Result<ResetRules> {
    node.deny_unknown(&["energy", "sequence_length", "scale"])?;
    let base = ResetRules::default();
    Ok(ResetRules {
        energy: node.get_or("energy", base.energy, Node::positive)?,
        sequence_length: node.get_or("sequence_length", base.sequence_length, above_zero)?,
        scale: node.get_or("scale", base.scale, |n| range(n).map(Some))?,
    })
}

fn optimizer(node: &Node<'_>) -> Result<AdamWOptions> {
    node.deny_unknown(&["rate", "betas", "epsilon", "weight_decay", "clip"])?;
    let AdamWOptions { rate, settings: base } = AdamWOptions::default();
    let settings = AdamWSettings {
        betas: node.get_or("betas", base.betas, |n| n.array("two numbers [b1, b2]", decay))?,
        epsilon: node.get_or("epsilon", base.epsilon, Node::positive)?,
        weight_decay: node.get_or("weight_decay", base.weight_decay, Node::not_negative)?,
        clip: node.get_or("clip", base.clip, Node::positive)?,
    };
    Ok(AdamWOptions { rate: node.get_or("rate", rate, Node::positive)?, settings })
}

fn normalisation(node: &Node<'_>) -> Result<Normalisation> {
    match node.text()? {
        "component" => Ok(Normalisation::Component),
        "cloth" => Ok(Normalisation::Cloth),
        _ => Err(node.invalid(r#""component" or "cloth""#)),
    }
}

fn schedule(node: &Node<'_>) -> Result<RateSchedule> {
    node.deny_unknown(&["warmup", "decay"])?;
    let read_decay = |node: &Node<'_>| {
        if node.value.as_str() == Some("none") {
            return Ok(Decay::None);
        }
        let expected = r#""none", { halvings = [steps, ..] } or { cosine = { final = rate } }"#;
        if !node.value.is_object() {
            return Err(node.invalid(expected));
        }
        node.deny_unknown(&["halvings", "cosine"])?;
        match (node.get("halvings"), node.get("cosine")) {
            (Some(at), None) => {
                Ok(Decay::Halvings(at.items()?.iter().map(above_zero).collect::<Result<_>>()?))
            }
            (None, Some(cosine)) => {
                cosine.deny_unknown(&["final"])?;
                Ok(Decay::Cosine { last: cosine.get_or("final", 0.0, Node::not_negative)? })
            }
            _ => Err(node.invalid(expected)),
        }
    };
    Ok(RateSchedule {
        warmup: node.get_or("warmup", 0, whole)?,
        decay: node.get_or("decay", Config::default().schedule.decay, read_decay)?,
    })
}

fn validation(node: &Node<'_>) -> Result<ValidationConfig> {
    node.deny_unknown(&["every", "frames", "iterations", "grids"])?;
    let base = ValidationConfig::default();
    let grids = |n: &Node<'_>| {
        let grids: Vec<Grid> = n.items()?.iter().map(grid).collect::<Result<_>>()?;
        if grids.is_empty() { Err(n.invalid("at least one grid [h, w]")) } else { Ok(grids) }
    };
    Ok(ValidationConfig {
        every: node.get_or("every", base.every, every)?,
        frames: node.get_or("frames", base.frames, |n| count(n, 1, 100_000))?,
        iterations: node.get_or("iterations", base.iterations, |n| count(n, 1, 100_000))?,
        grids: node.get_or("grids", base.grids, grids)?,
    })
}

fn every(node: &Node<'_>) -> Result<Every> {
    let expected = "{ steps = N } or { minutes = M }";
    if !node.value.is_object() {
        return Err(node.invalid(expected));
    }
    node.deny_unknown(&["steps", "minutes"])?;
    match (node.get("steps"), node.get("minutes")) {
        (Some(steps), None) => Ok(Every::Steps(above_zero(&steps)?)),
        (None, Some(minutes)) => Ok(Every::Minutes(minutes.positive()?)),
        _ => Err(node.invalid(expected)),
    }
}

fn grid(node: &Node<'_>) -> Result<Grid> {
    let expected = format!("[h, w], each {MIN_GRID} to {MAX_GRID}");
    let [h, w] = node.array(&expected, Node::count)?;
    let possible = [h, w].iter().all(|n| (MIN_GRID..=MAX_GRID).contains(n));
    if possible { Ok(Grid { h, w }) } else { Err(node.invalid(expected)) }
}

fn range(node: &Node<'_>) -> Result<Range> {
    let expected = "two numbers above 0, [smallest, largest]";
    let range: Range = node.array(expected, Node::number)?;
    if range[0] > 0.0 && range[0] <= range[1] { Ok(range) } else { Err(node.invalid(expected)) }
}

fn whole(node: &Node<'_>) -> Result<u64> {
    node.count().map(|n| n as u64)
}

fn above_zero(node: &Node<'_>) -> Result<u64> {
    whole(node).ok().filter(|&n| n > 0).ok_or_else(|| node.invalid("a whole number, 1 or more"))
}

fn count(node: &Node<'_>, least: usize, most: usize) -> Result<usize> {
    let count = node.count().ok().filter(|n| (least..=most).contains(n));
    count.ok_or_else(|| node.invalid(format!("a whole number, {least} to {most}")))
}

/// Reads a probability or a fraction.
fn share(node: &Node<'_>) -> Result<f64> {
    let share = node.number().ok().filter(|v| (0.0..=1.0).contains(v));
    share.ok_or_else(|| node.invalid("a number from 0 to 1"))
}

/// Reads a factor that is applied repeatedly, such as a decay or a probability of continuing. It must be
/// below 1, with which nothing would ever decay or end.
fn decay(node: &Node<'_>) -> Result<f64> {
    let decay = node.number().ok().filter(|v| (0.0..1.0).contains(v));
    decay.ok_or_else(|| node.invalid("a number, 0 or more and below 1"))
}

/// Serializes a grid as it is written in a configuration, `[h, w]`.
pub(super) fn serialize_grid<S: Serializer>(grid: &Grid, to: S) -> std::result::Result<S::Ok, S::Error> {
    [grid.h, grid.w].serialize(to)
}

/// Serializes grids as they are written in a configuration, `[[h, w], ..]`.
pub(super) fn serialize_grids<S: Serializer>(grids: &[Grid], to: S) -> std::result::Result<S::Ok, S::Error> {
    grids.iter().map(|g| [g.h, g.w]).collect::<Vec<_>>().serialize(to)
}
