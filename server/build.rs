//! The page is embedded in the binary; this builds it anew when a file of the page changes.
fn main() {
    println!("cargo::rerun-if-changed=../client/web");
}
