//! What a quality sets.

use crate::config::FrameFilter;
use crate::march::{WINDOW_FRAMES_MAX, WindowPlan};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use skycell_protocol::SunDepth;

/// Settings that trade speed for accuracy. The march's belong to a view cell, since its viewers share what is marched;
/// mip bias and filter are a viewer's own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct QualitySettings {
    /// Steps through a layer's thickness, 1 to 4096.
    pub march_steps: u32,
    /// Samples towards the sun, 1 to 64; without: the scene's.
    #[serde(default)]
    pub sun_steps: Option<u32>,
    /// How optical depth towards the sun comes about; without: the scene's choice.
    #[serde(default)]
    pub sun_depth: Option<SunDepth>,
    /// Terms of the multiple-scattering sum, 1 to 16; without, and at most: the scene's.
    #[serde(default)]
    pub octaves: Option<u32>,
    /// Jittered samples that a texel averages, 1 to 16.
    pub samples: u32,
    /// Where several texels make a pixel, it is their samples together that are so many.
    #[serde(default)]
    pub samples_by_area: bool,
    /// Halvings of the cache's resolution below the screen's, 0 to 4.
    pub mip_bias: f64,
    /// How frames read the cache.
    pub frame_filter: FrameFilter,
    /// Most places along a ray at which a viewer away from where texels were marched looks whether it sees what they show,
    /// 0 to 64; 0: proxy spheres alone.
    #[serde(default = "default_parallax_steps")]
    pub parallax_steps: u32,
}

/// From this mip bias on there are few tiles: at 0 three times as many.
pub const FEW_TILES_MIP_BIAS: f64 = 1.0;

/// Most places that a search for what is seen may look at.
pub const PARALLAX_STEPS_MAX: u32 = 64;

/// Tuned: mean FLIP 1 km beside the reference is .0705 with 16 steps, .0672 with 32, .1705 without (320×180).
#[must_use]
pub const fn default_parallax_steps() -> u32 {
    16
}

impl Default for QualitySettings {
    fn default() -> Self {
        Self {
            march_steps: 128,
            sun_steps: None,
            sun_depth: None,
            octaves: None,
            samples: 8,
            samples_by_area: false,
            mip_bias: 0.0,
            frame_filter: FrameFilter::CatmullRom,
            parallax_steps: default_parallax_steps(),
        }
    }
}

impl QualitySettings {
    /// How a viewer with rays of its own spreads its pictures over frames.
    #[must_use]
    pub fn window_plan(&self) -> WindowPlan {
        // The ladder's point where the cache is read coarsely too; four samples a pixel where it is not.
        let coarse = self.mip_bias >= 0.5;
        WindowPlan {
            frames: WINDOW_FRAMES_MAX,
            divisor: if coarse { 4 } else { 2 },
            depth_segments: if coarse { 3 } else { 2 },
            refinement: 2,
        }
    }

    /// The march of both that is finer in each respect; without, sun steps and octaves count as the scene's. What only
    /// frames need stays.
    #[must_use]
    pub fn finest_march(self, other: &Self, scene_sun_steps: u32, scene_octaves: u32) -> Self {
        let more = |a: Option<u32>, b: Option<u32>, scene: u32| {
            let most = a.unwrap_or(scene).max(b.unwrap_or(scene));
            (most != scene).then_some(most)
        };
        Self {
            march_steps: self.march_steps.max(other.march_steps),
            sun_steps: more(self.sun_steps, other.sun_steps, scene_sun_steps),
            // The volume errs less at as many steps.
            sun_depth: match (self.sun_depth, other.sun_depth) {
                (Some(SunDepth::Volume), _) | (_, Some(SunDepth::Volume)) => Some(SunDepth::Volume),
                (own, others) => own.or(others),
            },
            octaves: more(self.octaves, other.octaves, scene_octaves),
            samples: self.samples.max(other.samples),
            samples_by_area: self.samples_by_area && other.samples_by_area,
            ..self
        }
    }
}

/// Settings that the server's configuration fixes whatever anybody asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct QualityOverrides {
    /// `render.march_steps`
    pub march_steps: Option<u32>,
    /// `render.samples`
    pub samples: Option<u32>,
    /// `render.samples_by_area`
    pub samples_by_area: Option<bool>,
    /// `render.mip_bias`
    pub mip_bias: Option<f64>,
    /// `render.frame_filter`
    pub frame_filter: Option<FrameFilter>,
    /// `render.parallax_steps`
    pub parallax_steps: Option<u32>,
}

impl QualityOverrides {
    /// Settings with what is fixed.
    #[must_use]
    pub fn over(&self, settings: QualitySettings) -> QualitySettings {
        QualitySettings {
            march_steps: self.march_steps.unwrap_or(settings.march_steps),
            samples: self.samples.unwrap_or(settings.samples),
            samples_by_area: self.samples_by_area.unwrap_or(settings.samples_by_area),
            mip_bias: self.mip_bias.unwrap_or(settings.mip_bias),
            frame_filter: self.frame_filter.unwrap_or(settings.frame_filter),
            parallax_steps: self.parallax_steps.unwrap_or(settings.parallax_steps),
            ..settings
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_finest_march_is_no_coarser_than_either_and_frames_stay_as_they_are() {
        let draft = QualitySettings {
            march_steps: 32,
            sun_steps: Some(3),
            samples: 16,
            samples_by_area: true,
            mip_bias: 2.0,
            ..QualitySettings::default()
        };
        let fine = QualitySettings::default();
        let both = draft.finest_march(&fine, 6, 4);
        assert_eq!((both.march_steps, both.samples), (128, 16));
        assert!(!both.samples_by_area);
        assert_eq!((both.sun_steps, both.mip_bias), (None, 2.0));
        let alone = draft.finest_march(&draft, 6, 4);
        assert_eq!(alone, draft);
    }
}
