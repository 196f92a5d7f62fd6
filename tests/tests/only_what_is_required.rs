//! What a scene lacks has no buffer, no pass and no read: shown by what the device's allocator holds, the passes that were
//! recorded, and the resources that the compiled shaders reach.

use serde_json::{Value, json};
use skycell_protocol::{Camera, FrameSize, RendererKind, Scene, Show, Stereo};
use skycell_server::config::RenderConfig;
use skycell_server::frame_loop::{StillRenderer, StillSettings};
use skycell_server::gpu::DeviceInventory;
use skycell_server::march::MarchSettings;
use skycell_tests::server::target_dir;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// What a small picture of a scene leaves on the device, and what its shaders reach.
fn rendered(
    document: &Value,
    kind: RendererKind,
) -> (DeviceInventory, BTreeMap<&'static str, BTreeSet<String>>) {
    rendered_as(document, kind, Show::Picture)
}

/// As [`rendered`], of a picture that shows something else.
fn rendered_as(
    document: &Value,
    kind: RendererKind,
    show: Show,
) -> (DeviceInventory, BTreeMap<&'static str, BTreeSet<String>>) {
    rendered_with(document, &settings(kind, show))
}

fn settings(kind: RendererKind, show: Show) -> StillSettings {
    StillSettings {
        renderer: kind,
        show,
        samples: 1,
        march: MarchSettings {
            steps: 16,
            ..MarchSettings::default()
        },
        ..StillSettings::default()
    }
}

fn rendered_with(
    document: &Value,
    settings: &StillSettings,
) -> (DeviceInventory, BTreeMap<&'static str, BTreeSet<String>>) {
    rendered_from(2.0, document, settings)
}

fn rendered_from(
    altitude_m: f64,
    document: &Value,
    settings: &StillSettings,
) -> (DeviceInventory, BTreeMap<&'static str, BTreeSet<String>>) {
    let scene = Scene::from_json(document).expect("a valid document");
    let noise = target_dir().expect("a folder").join("noise-of-tests");
    let mut still =
        StillRenderer::new(RenderConfig::new(noise), Arc::new(scene), &[]).expect("a device");
    let camera = Camera::new([0.0, altitude_m, 0.0], 0.0, 30.0, 60.0).expect("a camera");
    let size = FrameSize::new(32, 16).expect("a size");
    still
        .render_with(camera, size, settings, |_| {})
        .expect("a picture");
    (still.inventory(), still.reads().expect("kernels compose"))
}

fn passes(inventory: &DeviceInventory, name: &str) -> u64 {
    inventory.passes.get(name).copied().unwrap_or(0)
}

/// Memory of the cache's textures.
fn atlas_bytes(inventory: &DeviceInventory) -> u64 {
    [
        "atlas radiance",
        "atlas distance",
        "previous radiance",
        "previous distance",
    ]
    .iter()
    .filter_map(|label| inventory.resources.get(*label))
    .map(|stats| stats.bytes)
    .sum()
}

#[test]
fn a_scene_without_layers_marches_nothing_and_reads_no_cache() {
    for layers in [
        json!([]),
        json!([{"density": {"model": "weather", "coverage": 0}}]),
        json!([{"extinction_per_m": 0}]),
    ] {
        let (inventory, reads) = rendered(
            &json!({"version": 1, "layers": layers}),
            RendererKind::Cached,
        );
        assert_eq!(passes(&inventory, "cache"), 0);
        // Texels that stand where bind groups want something.
        assert!(atlas_bytes(&inventory) < 4096, "{inventory:?}");
        assert!(passes(&inventory, "composite") > 0);
        for kernel in ["march_texels", "march_pixels", "audit_texels"] {
            assert!(!reads.contains_key(kernel), "{layers}: {reads:?}");
        }
        for name in ["atlas_radiance", "atlas_distance", "page_table"] {
            assert!(!reads["composite"].contains(name), "{layers}: {reads:?}");
        }
    }
}

#[test]
fn a_cached_picture_has_no_marched_pixels_and_the_other_way_round() {
    let document = json!({"version": 1});
    let (inventory, _) = rendered(&document, RendererKind::Cached);
    assert!(passes(&inventory, "cache") > 0 && passes(&inventory, "screen-space") == 0);
    assert!(!inventory.has("marched pixels"), "{inventory:?}");
    assert!(atlas_bytes(&inventory) > 1 << 20, "{inventory:?}");
    let (inventory, _) = rendered(&document, RendererKind::ScreenSpace);
    assert!(passes(&inventory, "cache") == 0 && passes(&inventory, "screen-space") > 0);
    assert!(inventory.has("marched pixels"), "{inventory:?}");
    assert!(atlas_bytes(&inventory) < 4096, "{inventory:?}");
}

#[test]
fn only_a_viewer_in_a_layer_has_a_near_part_of_that_layer_alone() {
    let document = json!({"version": 1, "layers": [
        {"name": "low", "base_altitude_m": 1500, "top_altitude_m": 4000},
        {"name": "high", "base_altitude_m": 6000, "top_altitude_m": 6600}]});
    let settings = settings(RendererKind::Cached, Show::Picture);
    let marches = |inventory: &DeviceInventory| {
        let kernels = ["march_texels", "march_pixels", "resolve_window"];
        kernels.map(|kernel| inventory.pipelines.get(kernel).copied())
    };
    let mut of_others = Vec::new();
    for altitude_m in [2.0, 5_000.0] {
        let (inventory, _) = rendered_from(altitude_m, &document, &settings);
        assert!(!inventory.has("marched pixels"), "{inventory:?}");
        assert_eq!(passes(&inventory, "screen-space"), 0, "{altitude_m} m");
        of_others.push(marches(&inventory));
    }
    let (inventory, reads) = rendered_from(2_500.0, &document, &settings);
    // The same marches serve all sides.
    let same = [marches(&inventory); 2];
    assert_eq!(of_others, same, "{inventory:?}");
    assert!(passes(&inventory, "cache") > 0 && passes(&inventory, "screen-space") > 0);
    assert!(atlas_bytes(&inventory) > 1 << 20, "{inventory:?}");
    assert!(reads["composite"].contains("page_table"), "{reads:?}");
    // Five values of a pixel of one layer, which the allocator rounds up.
    let near = inventory.resources["marched pixels"].bytes;
    let one_layer = 32 * 16 * 5 * 4;
    assert!((one_layer..one_layer + 256).contains(&near), "{near}");
}

#[test]
fn a_second_eye_takes_two_views_and_half_of_a_picture_more_and_no_pass_and_no_pipeline() {
    let document = json!({"version": 1});
    for kind in [RendererKind::Cached, RendererKind::ScreenSpace] {
        let [one, two] = [None, Stereo::new(0.064).ok()].map(|stereo| {
            let settings = StillSettings {
                stereo,
                ..settings(kind, Show::Picture)
            };
            rendered_with(&document, &settings).0
        });
        assert_eq!(one.pipelines, two.pipelines, "{kind:?}");
        for name in ["composite", "cache", "fade", "inspection"] {
            let [a, b] = [&one, &two].map(|inventory| passes(inventory, name));
            // A pair of people's eyes may need a tile more at a rim.
            assert!(a == b || name == "cache", "{kind:?}, {name}: {a} and {b}");
        }
        let count = |inventory: &DeviceInventory, label: &str| {
            inventory
                .resources
                .get(label)
                .map_or(0, |stats| stats.count)
        };
        // For sky and ground of each eye.
        for (label, of_one, of_two) in [("view", 2, 4), ("picture", 1, 1)] {
            let found = [&one, &two].map(|inventory| count(inventory, label));
            assert_eq!(found, [of_one, of_two], "{kind:?}, {label}");
        }
        let marched = u64::from(kind == RendererKind::ScreenSpace);
        let found = [&one, &two].map(|inventory| count(inventory, "marched pixels"));
        assert_eq!(found, [marched, 2 * marched], "{kind:?}");
    }
}

#[test]
fn a_layer_that_is_filled_reads_neither_maps_nor_noise() {
    let document = json!({"version": 1, "layers": [{"density": {"model": "homogeneous"}}]});
    let (inventory, reads) = rendered(&document, RendererKind::Cached);
    // Texels that stand where bind groups want something.
    for label in ["maps", "profile", "shape", "detail"] {
        let stats = inventory.resources[label];
        assert!(stats.bytes <= 4096, "{label}: {stats:?}");
    }
    assert!(!inventory.has("blend maps"), "{inventory:?}");
    let march = &reads["march_texels"];
    for name in ["field_maps", "field_shape", "field_detail", "field_grids"] {
        assert!(!march.contains(name), "{march:?}");
    }
    let (inventory, reads) = rendered(&json!({"version": 1}), RendererKind::Cached);
    // One layer of maps for one layer of clouds.
    let maps = inventory.resources["maps"].bytes;
    assert!((1 << 22..2 << 22).contains(&maps), "{maps}");
    assert!(
        inventory.resources["shape"].bytes >= 1 << 22,
        "{inventory:?}"
    );
    let march = &reads["march_texels"];
    assert!(
        march.contains("field_maps") && !march.contains("field_grids"),
        "{march:?}"
    );
}

#[test]
fn a_plain_picture_has_nothing_of_views_and_one_of_the_field_has_its_own_pass() {
    let document = json!({"version": 1});
    let (inventory, reads) = rendered(&document, RendererKind::Cached);
    assert!(!inventory.has("inspection") && passes(&inventory, "inspection") == 0);
    assert!(!reads.contains_key("inspect"), "{reads:?}");
    let (inventory, reads) = rendered_as(&document, RendererKind::Cached, Show::Density);
    assert!(inventory.has("inspection") && passes(&inventory, "inspection") == 1);
    assert!(reads["inspect"].contains("field_shape"), "{reads:?}");
}

#[test]
fn a_sheet_of_ice_reads_one_map_and_no_noise() {
    let document = json!({"version": 1, "layers": [{"family": "cirrus"}]});
    let (_, reads) = rendered(&document, RendererKind::Cached);
    let march = &reads["march_texels"];
    assert!(march.contains("field_maps"), "{march:?}");
    for name in [
        "field_profile",
        "field_shape",
        "field_detail",
        "field_grids",
    ] {
        assert!(!march.contains(name), "{march:?}");
    }
}

#[test]
fn only_a_scene_whose_air_is_computed_has_tables_of_it() {
    let names = [
        "air",
        "air base",
        "sky",
        "aerosol",
        "haze",
        "haze extinction",
    ];
    for (model, is_there) in [("analytic", false), ("uniform", false), ("physical", true)] {
        let document = json!({"version": 1, "layers": [], "atmosphere": {"model": model}});
        let (inventory, reads) = rendered(&document, RendererKind::Cached);
        for name in names {
            assert_eq!(
                inventory.has(name),
                is_there,
                "{model}, {name}: {inventory:?}"
            );
        }
        for kernel in ["make_air_view", "make_air_haze"] {
            assert_eq!(reads.contains_key(kernel), is_there, "{model}: {reads:?}");
        }
        assert_eq!(
            reads["composite"].contains("air_table"),
            is_there,
            "{reads:?}"
        );
        // Haze is in front of clouds, of which there are none.
        assert!(!reads["composite"].contains("source_table"), "{reads:?}");
    }
}

#[test]
fn only_a_sun_volume_that_is_asked_for_and_lit_stands_on_the_device() {
    let volume = json!({"sun_depth": "volume"});
    for (what, document) in [
        (
            "the cone",
            json!({"version": 1, "light": {"sun_depth": "cone"}}),
        ),
        (
            "a low sun",
            json!({"version": 1, "light": volume, "sun": {"elevation_deg": 5}}),
        ),
        (
            "no layer",
            json!({"version": 1, "light": volume, "layers": []}),
        ),
    ] {
        let (inventory, _) = rendered(&document, RendererKind::ScreenSpace);
        assert_eq!(passes(&inventory, "sun-volume"), 0, "{what}");
        assert!(!inventory.has("sun volume"), "{what}: {inventory:?}");
    }
    let (_, reads) = rendered(
        &json!({"version": 1, "light": {"sun_depth": "cone"}}),
        RendererKind::ScreenSpace,
    );
    assert!(!reads["march_pixels"].contains("sun_depths"), "{reads:?}");
    let (inventory, reads) = rendered(
        &json!({"version": 1, "light": volume}),
        RendererKind::ScreenSpace,
    );
    assert!(passes(&inventory, "sun-volume") > 0);
    assert!(inventory.has("sun volume"), "{inventory:?}");
    assert!(reads["march_pixels"].contains("sun_depths"), "{reads:?}");
}

#[test]
fn only_a_scene_that_asks_for_light_shafts_has_them() {
    let air = |shafts: bool| json!({"model": "physical", "light_shafts": shafts});
    let names = ["light shafts", "light shafts' air", "cloud shadows"];
    for (what, document, is_there) in [
        (
            "off",
            json!({"version": 1, "atmosphere": air(false)}),
            false,
        ),
        ("another sky", json!({"version": 1}), false),
        (
            "no cloud",
            json!({"version": 1, "layers": [], "atmosphere": air(true)}),
            false,
        ),
        ("on", json!({"version": 1, "atmosphere": air(true)}), true),
    ] {
        for kind in [RendererKind::Cached, RendererKind::ScreenSpace] {
            let (inventory, reads) = rendered(&document, kind);
            for name in names {
                assert_eq!(
                    inventory.has(name),
                    is_there,
                    "{what}, {name}: {inventory:?}"
                );
            }
            assert_eq!(passes(&inventory, "light-shafts") > 0, is_there, "{what}");
            for kernel in ["cloud_shadows", "make_light_shafts"] {
                assert_eq!(reads.contains_key(kernel), is_there, "{what}: {reads:?}");
            }
            for name in ["shaft_table", "shaft_frame"] {
                assert_eq!(
                    reads["composite"].contains(name),
                    is_there,
                    "{what}: {reads:?}"
                );
            }
        }
    }
}
