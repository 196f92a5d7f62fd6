//! Causes by which texels age, and how much of each.

use anyhow::Context;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use skycell_protocol::Scene;

/// Why a texel no longer shows what is to be seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// It averages few samples; the amount is their number, and nothing else has changed.
    Samples,
    /// Wind has carried the clouds past the reference, m.
    Wind,
    /// The same, and then every texel has taken a sample into which the old ones were carried over, m.
    Carried,
    /// Noise has risen through the clouds, m.
    Evolution,
    /// The sun has moved, degrees.
    Sun,
    /// There is more cloud, of 1.
    Coverage,
    /// Clouds are of another type, of 1.
    Type,
}

impl Cause {
    /// All, in the order of the report.
    pub const ALL: [Self; 7] = [
        Self::Samples,
        Self::Wind,
        Self::Carried,
        Self::Evolution,
        Self::Sun,
        Self::Coverage,
        Self::Type,
    ];

    /// As people read it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Wind => "wind",
            Self::Carried => "carried over",
            Self::Evolution => "evolution",
            Self::Sun => "sun",
            Self::Coverage => "coverage",
            Self::Type => "type",
        }
    }

    /// What amounts are counted in.
    #[must_use]
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Samples => "",
            Self::Wind | Self::Carried | Self::Evolution => "m",
            Self::Sun => "deg",
            Self::Coverage | Self::Type => "of 1",
        }
    }

    /// What is measured, by rising age.
    #[must_use]
    pub const fn amounts(self, is_quick: bool) -> &'static [f64] {
        match (self, is_quick) {
            (Self::Samples, false) => &[1.0, 2.0, 4.0, 8.0],
            (Self::Samples, true) => &[1.0, 4.0],
            (Self::Wind | Self::Carried | Self::Evolution, false) => &[6.0, 12.0, 24.0, 48.0, 96.0],
            (Self::Wind | Self::Carried | Self::Evolution, true) => &[48.0],
            (Self::Sun, false) => &[0.25, 0.5, 1.0, 2.0, 4.0],
            (Self::Sun, true) => &[1.0],
            (Self::Coverage | Self::Type, false) => &[0.004, 0.008, 0.016, 0.032],
            (Self::Coverage | Self::Type, true) => &[0.016],
        }
    }

    /// Steps of the sky that an amount is, as texels are told (`frame_loop/sky_steps`).
    #[must_use]
    pub fn sky_steps(self, amount: f64) -> f64 {
        match self {
            Self::Sun => amount / 0.25,
            Self::Coverage | Self::Type => amount * 256.0,
            _ => 0.0,
        }
    }

    /// The scene in which clouds drift or rise, one metre a second, or in which light or clouds are others.
    pub(super) fn scene(self, base: &Scene, amount: f64) -> anyhow::Result<Scene> {
        let wind = match self {
            Self::Wind | Self::Carried => 1.0,
            _ => 0.0,
        };
        let mut document = still(base, wind)?;
        match self {
            Self::Evolution => of_layers(&mut document, "evolution_m_per_s", |_| 1.0),
            Self::Coverage => of_layers(&mut document, "coverage", |value| value + amount),
            Self::Type => of_layers(&mut document, "type", |value| value + amount),
            Self::Sun => {
                let sun = &mut document["sun"];
                let elevation_deg = sun["elevation_deg"].as_f64().context(
                    "--scene has a sun by place and date; allowed: one by azimuth and elevation",
                )?;
                sun["elevation_deg"] = json!(elevation_deg + amount);
            }
            Self::Samples | Self::Wind | Self::Carried => {}
        }
        Scene::from_json(&document).with_context(|| format!("the scene for {}", self.name()))
    }

    /// The scene in which drifted clouds stand, and noise rises so slowly that nobody sees it: texels are refreshed as under wind.
    pub(super) fn standing(base: &Scene) -> anyhow::Result<Scene> {
        let mut document = still(base, 0.0)?;
        of_layers(&mut document, "evolution_m_per_s", |_| 1e-6);
        Scene::from_json(&document).context("the scene that stands")
    }
}

/// A scene of this wind without evolution.
pub(super) fn still(base: &Scene, wind_m_per_s: f64) -> anyhow::Result<Value> {
    let mut document = serde_json::to_value(base.to_document())?;
    document["wind"]["speed_m_per_s"] = json!(wind_m_per_s);
    of_layers(&mut document, "evolution_m_per_s", |_| 0.0);
    if let Some(layers) = document["layers"].as_array_mut() {
        for layer in layers {
            layer["wind"] = Value::Null;
        }
    }
    Ok(document)
}

/// Changes a number of every layer that has it.
fn of_layers(document: &mut Value, key: &str, to: impl Fn(f64) -> f64) {
    for layer in document["layers"].as_array_mut().into_iter().flatten() {
        let value = layer["density"].get_mut(key);
        if let Some(value) = value.filter(|value| value.is_number()) {
            *value = json!(to(value.as_f64().unwrap_or_default()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cause_changes_what_it_is_called_by_and_nothing_else() {
        let base = Scene::default();
        let before = Scene::from_json(&still(&base, 0.0).expect("a document")).expect("a scene");
        let after = |cause: Cause, amount| cause.scene(&base, amount).expect("a scene");
        assert_eq!(
            after(Cause::Samples, 4.0).to_document(),
            before.to_document()
        );
        let wind = after(Cause::Wind, 6.0);
        assert_eq!(wind.layer_wind(0).speed_m_per_s(), 1.0);
        assert_eq!(wind.sun(), before.sun());
        let sun = after(Cause::Sun, 2.0);
        assert_eq!(sun.layers(), before.layers());
        let turned = sun
            .sun()
            .direction()
            .angle_between(before.sun().direction());
        assert!((turned.to_degrees() - 2.0).abs() < 1e-9, "{turned}");
        for cause in [Cause::Coverage, Cause::Type, Cause::Evolution] {
            let changed = after(cause, 0.016);
            assert_eq!(changed.sun(), before.sun());
            assert_ne!(changed.layers(), before.layers(), "{}", cause.name());
        }
    }
}
