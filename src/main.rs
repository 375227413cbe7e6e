//! The `fnopt` command.
fn main() {}
