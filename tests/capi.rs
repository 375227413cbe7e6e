//! The header of the C interface has what its sources have. `tests/c/run.sh` builds programs against it.

#![allow(unsafe_code)]

use fnopt::{Error, Result};
use std::path::Path;

/// Its tests are run here, where they need no build with the feature.
#[path = "../src/capi/check.rs"]
#[allow(dead_code)]
mod check;

/// Returns the functions that a source exports, each with the number of its arguments.
fn exported(source: &str) -> Vec<(String, usize)> {
    let rest = source.split("extern \"C\" fn ").skip(1);
    let found = rest.map(|rest| {
        let (name, rest) = rest.split_once('(').expect("arguments");
        let list = rest.split_once(')').expect("an end of the arguments").0;
        (name.to_owned(), list.split(',').filter(|argument| !argument.trim().is_empty()).count())
    });
    found.collect()
}

/// Returns the functions that a header declares likewise.
fn declared(header: &str) -> Vec<(String, usize)> {
    let is_code = |line: &&str| !line.trim_start().starts_with("//");
    let code = header.lines().filter(is_code).collect::<Vec<_>>().join(" ");
    let found = code.split(';').filter_map(|statement| {
        let (before, list) = statement.trim_end().strip_suffix(')')?.rsplit_once('(')?;
        let name = before.rsplit([' ', '*']).next()?;
        Some((name.to_owned(), if list == "void" { 0 } else { list.split(',').count() }))
    });
    found.collect()
}

#[test]
fn the_header_declares_every_function_with_its_arguments() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &Path| std::fs::read_to_string(path).expect("a file of this checkout");
    let sources = std::fs::read_dir(root.join("src/capi")).expect("a folder of this checkout");
    let mut exported: Vec<_> =
        sources.flat_map(|entry| exported(&read(&entry.expect("an entry").path()))).collect();
    let mut declared = declared(&read(&root.join("include/fnopt.h")));
    exported.sort();
    declared.sort();
    assert_eq!(declared, exported, "cbindgen --output include/fnopt.h makes the header anew");
    assert!(exported.len() > 15 && exported.contains(&("fnopt_step".into(), 2)), "{exported:?}");
}
