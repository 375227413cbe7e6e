//! `fnopt fabrics`: the fabrics that a scene may name, and how they drape.

use super::output::{output, status};
use super::{Ending, go_on, interrupt_flag};
use anyhow::Result;
use fnopt::eval::drape::{Cantilever, Drape, GRAVITY_M_S2, cantilever, drape};
use fnopt::scene::{Fabric, fabrics};
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

fn measure(fabric: &Fabric, args: &Args) -> Result<(Cantilever, Drape)> {
    let (moduli, mass) = (fabric.moduli, fabric.areal_mass_kg_m2);
    let strip = cantilever(moduli, mass, STRIP)?;
    let disc = drape(moduli, mass, args.grid as usize, args.times as usize)?;
    if !(strip.is_still && disc.is_still) {
        status!(
            "{}: it did not come to rest; the numbers are those of the shape that it reached",
            fabric.name
        );
    }
    Ok((strip, disc))
}

fn bending_length_m(fabric: &Fabric) -> f64 {
    fabric.moduli.bending_length_m(fabric.areal_mass_kg_m2, GRAVITY_M_S2)
}

fn described(fabric: &Fabric) -> String {
    let Fabric { description, areal_mass_kg_m2, moduli, .. } = fabric;
    format!(
        "{:3.0} g/m^2  stretch {:4.0} N/m  shear {:5.1} N/m  bending {:4.1} uN m, {:4.1} mm  {description}",
        1e3 * areal_mass_kg_m2,
        moduli.stretch_modulus,
        moduli.shear_modulus,
        1e6 * moduli.bending_stiffness,
        1e3 * bending_length_m(fabric)
    )
}

fn compared(fabric: &Fabric, (strip, disc): &(Cantilever, Drape)) -> String {
    let expected = bending_length_m(fabric);
    let (mean, deviation) = disc.coefficient();
    format!(
        "bending length {:5.2} mm, measured {:5.2} mm ({:+.1} %)  drape coefficient {:4.1} % +- {:.1} %",
        1e3 * expected,
        1e3 * strip.bending_length_m,
        100.0 * (strip.bending_length_m / expected - 1.0),
        100.0 * mean,
        100.0 * deviation
    )
}

fn document(fabric: &Fabric, measured: Option<&(Cantilever, Drape)>) -> Value {
    let mut document = json!({
        "name": fabric.name,
        "description": fabric.description,
        "areal_mass_kg_m2": fabric.areal_mass_kg_m2,
        "material": fabric.moduli,
        "bending_length_m": bending_length_m(fabric),
        "source": fabric.source,
    });
    if let Some((strip, disc)) = measured {
        document["measured"] = json!({
            "overhang_m": strip.overhang_m,
            "bending_length_m": strip.bending_length_m,
            "drape_coefficient": disc.coefficient().0,
            "drape_coefficients": disc.coefficients,
            "at_rest": strip.is_still && disc.is_still,
        });
    }
    document
}
