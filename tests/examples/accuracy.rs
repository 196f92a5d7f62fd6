//! Prints how far pictures of the default scene are from each other: the cache against the screen-space renderer, and
//! both against themselves with more samples, which is the noise in the comparison.
//! `cargo run --release -p skycell-tests --example accuracy -- [WIDTH HEIGHT [FOLDER]]`; pictures are kept in FOLDER.

use skycell_protocol::{FrameSize, RendererKind};
use skycell_server::config::FrameFilter;
use skycell_tests::accuracy::{Recipe, distance, picture};

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let number = |i: usize, default: u32| args.get(i).map_or(Ok(default), |a| a.parse());
    let size = FrameSize::new(number(0, 640)?, number(1, 360)?)?;
    let screen = Recipe::screen_space();
    let cached = Recipe {
        renderer: RendererKind::Cached,
        ..screen
    };
    let recipes = [
        ("screen-8", screen),
        (
            "screen-32",
            Recipe {
                samples: 32,
                ..screen
            },
        ),
        ("cached-8", cached),
        (
            "cached-8-bilinear",
            Recipe {
                filter: FrameFilter::Bilinear,
                ..cached
            },
        ),
        (
            "cached-32",
            Recipe {
                samples: 32,
                ..cached
            },
        ),
    ];
    let mut pictures = Vec::new();
    for (name, recipe) in recipes {
        let (image, texels) = picture(recipe, size)?;
        if let Some(folder) = args.get(2) {
            image.save(std::path::Path::new(folder).join(format!("{name}.png")))?;
        }
        if texels > 0 {
            println!("{name}: {texels} texel updates");
        }
        pictures.push((name, image));
    }
    for (a, b) in [(0, 1), (2, 4), (0, 2), (0, 3), (1, 4)] {
        let apart = distance(&pictures[a].1, &pictures[b].1)?;
        println!(
            "{:>9} against {:<17} FLIP {:.4}  SSIM {:.4}",
            pictures[a].0, pictures[b].0, apart.flip, apart.ssim
        );
    }
    Ok(())
}
