//! Mean FLIP of two pictures: `cargo run --release -p skycell-tests --example flip -- reference.png test.png`.

fn main() -> anyhow::Result<()> {
    let paths: Vec<String> = std::env::args().skip(1).collect();
    let [reference, test] = paths.as_slice() else {
        anyhow::bail!(
            "two pictures are compared: flip reference.png test.png [got {}]",
            paths.len()
        );
    };
    let open = |path: &str| -> anyhow::Result<nv_flip::FlipImageRgb8> {
        let image = image::open(path)?.to_rgb8();
        Ok(nv_flip::FlipImageRgb8::with_data(
            image.width(),
            image.height(),
            image.as_raw(),
        ))
    };
    let error = nv_flip::flip(
        open(reference)?,
        open(test)?,
        nv_flip::DEFAULT_PIXELS_PER_DEGREE,
    );
    println!("{:.5}", nv_flip::FlipPool::from_image(&error).mean());
    Ok(())
}
