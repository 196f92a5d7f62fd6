//! Skycell.
fn main() {}
