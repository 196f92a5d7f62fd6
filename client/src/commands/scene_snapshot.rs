//! `skycell scene snapshot`.

use std::path::PathBuf;

use anyhow::Context;
use serde_json::json;
use skycell_client::HttpApi;

use super::print_line;

/// Where to stand and look; what is left out is the server's choice.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Where to write the picture: .exr for linear radiance, else PNG.
    file: PathBuf,
    /// East of the world's origin.
    #[arg(long, allow_negative_numbers = true)]
    x_m: Option<f64>,
    /// Above the ground sphere.
    #[arg(long, allow_negative_numbers = true)]
    altitude_m: Option<f64>,
    /// South of the world's origin.
    #[arg(long, allow_negative_numbers = true)]
    z_m: Option<f64>,
    /// Clockwise from north.
    #[arg(long, allow_negative_numbers = true)]
    yaw_deg: Option<f64>,
    /// Up from the horizon.
    #[arg(long, allow_negative_numbers = true)]
    pitch_deg: Option<f64>,
    /// The angle between the picture's upper and lower edge.
    #[arg(long)]
    fov_deg: Option<f64>,
    /// Pixels in a row.
    #[arg(long)]
    width: Option<u32>,
    /// Rows.
    #[arg(long)]
    height: Option<u32>,
}

impl Arguments {
    /// As the query has it.
    fn view(&self) -> Vec<(&'static str, String)> {
        let numbers = [
            ("x_m", self.x_m),
            ("altitude_m", self.altitude_m),
            ("z_m", self.z_m),
            ("yaw_deg", self.yaw_deg),
            ("pitch_deg", self.pitch_deg),
            ("fov_deg", self.fov_deg),
            ("width", self.width.map(f64::from)),
            ("height", self.height.map(f64::from)),
        ];
        let ending = self.file.extension();
        let is_exr = ending.is_some_and(|ending| ending.eq_ignore_ascii_case("exr"));
        let format = is_exr.then_some("exr");
        numbers
            .into_iter()
            .filter_map(|(name, number)| Some((name, number?.to_string())))
            .chain(format.map(|format| ("format", format.to_owned())))
            .collect()
    }
}

pub(super) async fn run(arguments: Arguments, api: &HttpApi, json: bool) -> anyhow::Result<()> {
    let picture = api.snapshot(&arguments.view()).await?;
    let file = &arguments.file;
    std::fs::write(file, &picture)
        .with_context(|| format!("{} cannot be written", file.display()))?;
    print_line(&if json {
        json!({"file": file, "bytes": picture.len()}).to_string()
    } else {
        format!("{}: {} bytes", file.display(), picture.len())
    })
}
