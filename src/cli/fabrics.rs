//! `fnopt fabrics`: the fabrics that a scene may name, and how they drape.

use super::output::{output, status};
use super::{Ending, go_on, interrupt_flag};
use anyhow::Result;
use fnopt::eval::drape::{Cantilever, Drape, GRAVITY_M_S2, cantilever, drape};
use fnopt::scene::{Fabric, Moduli, fabrics};
use serde_json::{Value, json};
use std::io::Write;

/// Edges along the overhang of the strip.
const STRIP: usize = 24;

/// Arguments of `fnopt fabrics`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Fabrics [default: all]
    #[arg(value_name = "FABRIC")]
    names: Vec<String>,
    /// Simulate the tests of a textile laboratory: the bending length of a cantilever (ISO 9073-7) and Cusick's drape
    /// coefficient (ISO 9073-9)
    #[arg(long)]
    measure: bool,
    /// Cells along the diameter of the draped disc
    #[arg(long, value_name = "N", default_value_t = 60, requires = "measure",
        value_parser = clap::value_parser!(u32).range(16..=256))]
    grid: u32,
    /// How often it is draped, each time from other small waves
    #[arg(long, value_name = "N", default_value_t = 5, requires = "measure",
        value_parser = clap::value_parser!(u32).range(1..=100))]
    times: u32,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Ending> {
    let wanted = match args.names.is_empty() {
        true => fabrics().to_vec(),
        false => args.names.iter().map(|name| Fabric::find(name, "fabrics")).collect::<fnopt::Result<_>>()?,
    };
    let width = wanted.iter().map(|fabric| fabric.name.len()).max().unwrap_or(0);
    let interrupted = interrupt_flag();
    let (mut out, mut documents, mut ending) = (output(), Vec::new(), Ending::Done);
    for fabric in &wanted {
        if go_on(&interrupted).is_break() {
            ending = Ending::Interrupted;
            break;
        }
        let measured = args.measure.then(|| measure(fabric, args)).transpose()?;
        if args.json {
            documents.push(document(fabric, measured.as_ref()));
            continue;
        }
        let of = measured.as_ref().map_or_else(|| described(fabric), |measured| compared(fabric, measured));
        writeln!(out, "{:<width$}  {of}", fabric.name)?;
        out.flush()?;
    }
    if args.json {
        writeln!(out, "{:#}", Value::Array(documents))?;
    }
    Ok(ending)
}

/// What the tests found: strips along the warp and along the weft, and the disc.
type Measured = ([Cantilever; 2], Drape);

fn measure(fabric: &Fabric, args: &Args) -> Result<Measured> {
    let (moduli, mass) = (fabric.moduli, fabric.areal_mass_kg_m2);
    let turned = Moduli { weave: moduli.weave.turned(), ..moduli };
    let strips = [cantilever(moduli, mass, STRIP)?, cantilever(turned, mass, STRIP)?];
    let disc = drape(moduli, mass, args.grid as usize, args.times as usize)?;
    if !(strips.iter().all(|strip| strip.is_still) && disc.is_still) {
        status!(
            "{}: it did not come to rest; the numbers are those of the shape that it reached",
            fabric.name
        );
    }
    Ok((strips, disc))
}

fn bending_lengths_m(fabric: &Fabric) -> [f64; 2] {
    fabric.moduli.bending_lengths_m(fabric.areal_mass_kg_m2, GRAVITY_M_S2)
}

fn described(fabric: &Fabric) -> String {
    let Fabric { description, areal_mass_kg_m2, moduli, .. } = fabric;
    let [warp, weft] = moduli.weave.stretch.map(|factor| factor * moduli.stretch_modulus);
    let [bend_warp, bend_weft] = moduli.weave.bend.map(|factor| 1e6 * factor * moduli.bending_stiffness);
    format!(
        "{:3.0} g/m^2  stretch {warp:4.0} x {weft:4.0} N/m  shear {:5.1} N/m  bending {bend_warp:4.1} x {bend_weft:4.1} uN m  {description}",
        1e3 * areal_mass_kg_m2,
        moduli.shear_modulus,
    )
}

fn compared(fabric: &Fabric, (strips, disc): &Measured) -> String {
    let [warp, weft] = bending_lengths_m(fabric).map(|length| 1e3 * length);
    let [of_warp, of_weft] = strips.map(|strip| 1e3 * strip.bending_length_m);
    let (mean, deviation) = disc.coefficient();
    let published = match fabric.published_drape_coefficients.map(|range| range.map(|c| 100.0 * c)) {
        None => String::new(),
        Some([least, most]) if least == most => format!(", published {least:.1} %"),
        Some([least, most]) => format!(", published {least:.1} to {most:.1} %"),
    };
    format!(
        "bending length {warp:5.2} x {weft:5.2} mm, measured {of_warp:5.2} x {of_weft:5.2} mm  drape coefficient {:4.1} % +- {:.1} %{published}",
        100.0 * mean,
        100.0 * deviation,
    )
}

fn document(fabric: &Fabric, measured: Option<&Measured>) -> Value {
    let mut document = json!({
        "name": fabric.name,
        "description": fabric.description,
        "areal_mass_kg_m2": fabric.areal_mass_kg_m2,
        "material": fabric.moduli,
        "bending_lengths_m": bending_lengths_m(fabric),
        "source": fabric.source,
        "published_drape_coefficients": fabric.published_drape_coefficients,
    });
    if let Some((strips, disc)) = measured {
        document["measured"] = json!({
            "overhangs_m": strips.map(|strip| strip.overhang_m),
            "bending_lengths_m": strips.map(|strip| strip.bending_length_m),
            "drape_coefficient": disc.coefficient().0,
            "drape_coefficients": disc.coefficients,
            "at_rest": strips.iter().all(|strip| strip.is_still) && disc.is_still,
        });
    }
    document
}
