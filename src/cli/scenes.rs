//! `fnopt scenes`: the scenes that come with the program.

use super::Ending;
use super::output::output;
use anyhow::Result;
use fnopt::scene::{NamedScene, named_scenes};
use std::io::Write;

/// Arguments of `fnopt scenes`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// A scene whose file is printed, as a start for one of your own [default: list them all]
    name: Option<String>,
    /// Print JSON, as a scene's file is anyway
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<Ending> {
    let mut out = output();
    if let Some(name) = &args.name {
        write!(out, "{}", NamedScene::find(name, "scenes")?.text)?;
    } else if args.json {
        let all: serde_json::Value = named_scenes().iter().map(described).collect();
        writeln!(out, "{all:#}")?;
    } else {
        let width = named_scenes().iter().map(|scene| scene.name.len()).max().unwrap_or(0);
        for NamedScene { name, description, .. } in named_scenes() {
            writeln!(out, "{name:<width$}  {description}")?;
        }
    }
    Ok(Ending::Done)
}

fn described(scene: &NamedScene) -> serde_json::Value {
    serde_json::json!({ "name": scene.name, "description": scene.description })
}
