use proptest::prelude::*;
use serde_json::json;

use super::*;

fn error_of(value: Value) -> SceneError {
    Scene::from_json(&value).expect_err("must be refused")
}

#[test]
fn the_default_document_is_a_scene() {
    let scene = Scene::try_from(SceneDocument::default()).expect("defaults are in range");
    assert_eq!(scene, Scene::default());
    assert_eq!(Scene::from_json(&json!({"version": 1})), Ok(scene));
}

#[test]
fn the_default_document_is_pinned() {
    let expected = json!({
        "version": 1,
        "planet": {"radius_m": 6360000.0, "ground_albedo": 0.1},
        "sun": {
            "azimuth_deg": 150.0, "elevation_deg": 40.0, "place_and_time": null,
            "irradiance_w_per_m2_nm": [1.474, 1.8504, 1.91198]
        },
        "moon": null,
        "stars": null,
        "atmosphere": {"model": "analytic", "aerosol_optical_depth": 0.08},
        "layers": [{
            "family": null, "name": "low", "base_altitude_m": 1500.0, "top_altitude_m": 4000.0,
            "density": {
                "model": "weather", "profile": "low", "pattern": "puffs", "coverage": 0.45,
                "type": 0.7, "map_span_m": 40000.0, "shape_period_m": 5000.0,
                "detail_period_m": 420.0, "detail_strength": 0.22, "seed": 1,
                "evolution_m_per_s": 0.0,
                "maps": {"coverage": null, "type": null, "profile": null, "transition_s": 0.0}
            },
            "extinction_per_m": 0.05, "single_scattering_albedo": 0.9999, "phase": null,
            "wind": null
        }],
        "light": {
            "phase": {"model": "hg-draine", "droplet_diameter_um": 20.0},
            "scattering": "fitted", "octaves": 4, "octave_attenuation": 0.5, "octave_contribution": 0.5,
            "octave_eccentricity": 0.5, "sun_steps": 6, "sun_depth": "cone", "sun_march_distance_m": 1500.0,
            "ambient": 1.0
        },
        "wind": {"towards_deg": 90.0, "speed_m_per_s": 5.0},
        "exposure_ev": 0.0,
        "tone": {"curve": "aces", "auto_exposure": null},
        "quality": null,
        "time": {
            "epoch": "1970-01-01T00:00:00Z", "sky_s_at_epoch": 0.0, "rate": 1.0,
            "paused_at": null, "wind_rate": null
        },
        "animation": [],
        "transition": null,
        "drift": null
    });
    assert_eq!(
        serde_json::to_value(SceneDocument::default()).expect("serialises"),
        expected
    );
}

#[test]
fn a_family_stands_for_what_its_layer_leaves_out() {
    for family in Family::ALL {
        let name = family.name();
        let plain = Scene::from_json(&json!({"version": 1, "layers": [{"family": name}]}));
        let plain = plain.expect("a family is a layer");
        let layer = &plain.layers()[0];
        assert_eq!((layer.family(), layer.name()), (Some(family), name));
        // Written out and read again it is the same.
        let written = serde_json::to_value(plain.to_document()).expect("serialises");
        assert_eq!(Scene::from_json(&written), Ok(plain.clone()));
        let changed = Scene::from_json(&json!({"version": 1, "layers": [
            {"family": name, "density": {"coverage": 0.25}}]}));
        let changed = changed.expect("a family's coverage can be set");
        let (was, is) = (&plain.layers()[0], &changed.layers()[0]);
        assert_eq!(is.base_altitude_m(), was.base_altitude_m());
        match (was.density(), is.density()) {
            (DensityModel::Weather(was), DensityModel::Weather(is)) => {
                assert_eq!((is.coverage(), is.pattern()), (0.25, was.pattern()));
                assert_eq!(is.map_span_m(), was.map_span_m());
            }
            (DensityModel::Cirrus(was), DensityModel::Cirrus(is)) => {
                assert_eq!(
                    (is.coverage(), is.optical_depth()),
                    (0.25, was.optical_depth())
                );
                assert_eq!(changed.layer_phase(0), &PhaseFunction::Ice);
            }
            other => panic!("{name}: {other:?}"),
        }
    }
    let error = error_of(json!({"version": 1, "layers": [{"family": "cumulos"}]}));
    assert_eq!(error.pointer, "/layers/0/family");
    let error = error_of(json!({"version": 1, "layers": [
        {"family": "cirrus", "density": {"shape_period_m": 100}}]}));
    assert!(error.allowed.contains("fibre_period_m"), "{error}");
}

#[test]
fn a_sheet_spreads_its_optical_depth_over_its_thickness() {
    let scene = Scene::from_json(&json!({"version": 1, "layers": [
        {"family": "cirrus", "base_altitude_m": 9000, "top_altitude_m": 9400,
         "density": {"optical_depth": 2}},
        {"family": "cirrostratus", "base_altitude_m": 9000, "top_altitude_m": 9000}]}));
    let scene = scene.expect("valid");
    assert_eq!(scene.layers()[0].extinction_per_m(), 0.005);
    assert!(scene.layers()[1].extinction_per_m().is_finite());
}

#[test]
fn a_bad_value_is_named_by_pointer_value_and_range() {
    let error = error_of(json!({
        "version": 1,
        "layers": [{"density": {"model": "weather", "coverage": 1.5}}]
    }));
    assert_eq!(
        error.to_string(),
        "/layers/0/density/coverage is 1.5; allowed: 0 to 1"
    );
}

#[test]
fn each_kind_of_bad_document_is_refused_where_it_is_wrong() {
    let five_layers: Vec<Value> = (0..5).map(|i| json!({"name": i.to_string()})).collect();
    for (document, pointer) in [
        (json!([]), ""),
        (json!({}), "/version"),
        (json!({"version": 2}), "/version"),
        (
            json!({"version": 1, "sun": {"elevation_deg": 91}}),
            "/sun/elevation_deg",
        ),
        (
            json!({"version": 1, "sun": {"elevation_deg": "high"}}),
            "/sun/elevation_deg",
        ),
        (
            json!({"version": 1, "sun": {"irradiance_w_per_m2_nm": [1, -1, 1]}}),
            "/sun/irradiance_w_per_m2_nm/1",
        ),
        (
            json!({"version": 1, "planet": {"radius_m": 0}}),
            "/planet/radius_m",
        ),
        (json!({"version": 1, "planet": 5}), "/planet"),
        (
            json!({"version": 1, "atmosphere": {"model": "tables"}}),
            "/atmosphere/model",
        ),
        (json!({"version": 1, "layers": five_layers}), "/layers"),
        (json!({"version": 1, "layers": [{}, {}]}), "/layers/1/name"),
        (
            json!({"version": 1, "layers": [{"name": ""}]}),
            "/layers/0/name",
        ),
        (
            json!({"version": 1, "layers": [{"name": "x".repeat(33)}]}),
            "/layers/0/name",
        ),
        (
            json!({"version": 1, "layers": [{"base_altitude_m": 5000}]}),
            "/layers/0/top_altitude_m",
        ),
        (
            json!({"version": 1, "layers": [{"density": {"model": "cheese"}}]}),
            "/layers/0/density/model",
        ),
        (
            json!({"version": 1, "layers": [{"density": {"model": "homogeneous", "coverage": 1}}]}),
            "/layers/0/density/coverage",
        ),
        (
            json!({"version": 1, "layers": [{"density": {"seed": 1.5}}]}),
            "/layers/0/density/seed",
        ),
        (
            json!({"version": 1, "layers": [{"wind": {"speed_m_per_s": 201}}]}),
            "/layers/0/wind/speed_m_per_s",
        ),
        (
            json!({"version": 1, "light": {"phase": {"model": "hg", "g": 1}}}),
            "/light/phase/g",
        ),
        (
            json!({"version": 1, "light": {"octaves": 0}}),
            "/light/octaves",
        ),
        (
            json!({"version": 1, "light": {"octaves": -1}}),
            "/light/octaves",
        ),
        (
            json!({"version": 1, "light": {"scattering": "octave"}}),
            "/light/scattering",
        ),
        (json!({"version": 1, "wind": null}), "/wind"),
        (json!({"version": 1, "exposure_ev": 31}), "/exposure_ev"),
        (
            json!({"version": 1, "tone": {"curve": "asec"}}),
            "/tone/curve",
        ),
        (
            json!({"version": 1, "tone": {"auto_exposure": {"min_ev": -31}}}),
            "/tone/auto_exposure/min_ev",
        ),
        (
            json!({"version": 1, "tone": {"auto_exposure": {"min_ev": 3, "max_ev": 2}}}),
            "/tone/auto_exposure/max_ev",
        ),
        (
            json!({"version": 1, "quality": {"max_error": 2}}),
            "/quality/max_error",
        ),
    ] {
        assert_eq!(error_of(document.clone()).pointer, pointer, "{document}");
    }
}

#[test]
fn an_unknown_key_is_answered_with_the_nearest_known_one() {
    let error = error_of(json!({
        "version": 1,
        "layers": [{"density": {"model": "weather", "covrage": 0.5}}]
    }));
    assert_eq!(error.pointer, "/layers/0/density/covrage");
    assert!(
        error.allowed.contains("did you mean \"coverage\"?"),
        "{error}"
    );
    let error = error_of(json!({"version": 1, "cheese": {"much": true}}));
    assert_eq!(error.pointer, "/cheese");
    assert!(
        error.allowed.contains("one of the keys version, planet"),
        "{error}"
    );
}

#[test]
fn a_layer_without_wind_of_its_own_drifts_with_the_scenes() {
    let scene = Scene::from_json(&json!({
        "version": 1,
        "layers": [{"name": "a"}, {"name": "b", "wind": {"towards_deg": 180, "speed_m_per_s": 9}}],
        "wind": {"towards_deg": 0, "speed_m_per_s": 2}
    }))
    .expect("a good scene");
    assert_eq!(scene.layer_wind(0), *scene.wind());
    assert_eq!(scene.layer_wind(1).speed_m_per_s(), 9.0);
    // Towards 180 degrees is south, and south is +z.
    assert!((scene.layer_wind(1).velocity_m_per_s().z - 9.0).abs() < 1e-12);
}

#[test]
fn a_domain_type_refuses_what_json_cannot_even_write() {
    for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let document = SceneDocument {
            exposure_ev: number,
            ..SceneDocument::default()
        };
        assert_eq!(
            Scene::try_from(document).map_err(|e| e.pointer),
            Err("/exposure_ev".to_owned())
        );
    }
}

fn in_range(range: crate::number_range::NumberRange) -> impl Strategy<Value = f64> {
    prop_oneof![Just(range.min), Just(range.max), range.min..=range.max]
}

fn wind() -> impl Strategy<Value = WindDocument> {
    (
        in_range(ranges::AZIMUTH_DEG),
        in_range(ranges::WIND_SPEED_M_PER_S),
    )
        .prop_map(|(towards_deg, speed_m_per_s)| WindDocument {
            towards_deg,
            speed_m_per_s,
        })
}

fn maps() -> impl Strategy<Value = MapsDocument> {
    let file = || {
        prop_oneof![
            Just(None),
            Just(Some("towers.png".to_owned())),
            Just(Some("0123456789abcdef.exr".to_owned()))
        ]
    };
    (file(), file(), file(), in_range(ranges::TRANSITION_S)).prop_map(
        |(coverage, cloud_type, profile, transition_s)| MapsDocument {
            coverage,
            cloud_type,
            profile,
            transition_s,
        },
    )
}

fn density() -> impl Strategy<Value = DensityDocument> {
    let weather = (
        in_range(ranges::COVERAGE),
        in_range(ranges::CLOUD_TYPE),
        in_range(ranges::MAP_SPAN_M),
        in_range(ranges::SHAPE_PERIOD_M),
        in_range(ranges::DETAIL_PERIOD_M),
        in_range(ranges::DETAIL_STRENGTH),
        any::<u32>(),
        in_range(ranges::EVOLUTION_M_PER_S),
        maps(),
        prop_oneof![Just(WeatherProfile::Low), Just(WeatherProfile::High)],
        prop_oneof![
            Just(WeatherPattern::Puffs),
            Just(WeatherPattern::Rolls),
            Just(WeatherPattern::Ripples),
            Just(WeatherPattern::Veils)
        ],
    )
        .prop_map(
            |(
                coverage,
                cloud_type,
                map_span_m,
                shape_period_m,
                detail_period_m,
                detail_strength,
                seed,
                evolution_m_per_s,
                maps,
                profile,
                pattern,
            )| {
                DensityDocument::Weather(WeatherDocument {
                    profile,
                    pattern,
                    coverage,
                    cloud_type,
                    map_span_m,
                    shape_period_m,
                    detail_period_m,
                    detail_strength,
                    seed,
                    evolution_m_per_s,
                    maps,
                })
            },
        );
    let places = || {
        [
            in_range(ranges::SHAPE_HORIZONTAL_M),
            in_range(ranges::SHAPE_ALTITUDE_M),
            in_range(ranges::SHAPE_HORIZONTAL_M),
        ]
    };
    let sizes = || [(); 3].map(|()| in_range(ranges::SHAPE_SIZE_M));
    let shape = prop_oneof![
        Just(ShapeDocument::Layer),
        (places(), sizes())
            .prop_map(|(center_m, size_m)| ShapeDocument::Box(BoxDocument { center_m, size_m })),
        (places(), in_range(ranges::SHAPE_SIZE_M)).prop_map(|(center_m, radius_m)| {
            ShapeDocument::Sphere(SphereDocument { center_m, radius_m })
        }),
    ];
    let homogeneous =
        shape.prop_map(|shape| DensityDocument::Homogeneous(HomogeneousDocument { shape }));
    let grid = (
        "[a-zA-Z0-9_-][a-zA-Z0-9._-]{0,20}",
        [(); 3].map(|()| 1..=400u32),
    )
        .prop_map(|(file, dimensions)| {
            DensityDocument::Grid(GridDocument {
                file,
                dimensions,
                ..GridDocument::default()
            })
        });
    let cirrus = (
        in_range(ranges::COVERAGE),
        in_range(ranges::CLOUD_TYPE),
        in_range(ranges::SHEET_OPTICAL_DEPTH),
        in_range(ranges::MAP_SPAN_M),
        in_range(ranges::FIBRE_PERIOD_M),
        in_range(ranges::AZIMUTH_DEG),
        any::<u32>(),
    )
        .prop_map(
            |(
                coverage,
                cloud_type,
                optical_depth,
                map_span_m,
                fibre_period_m,
                fibres_towards_deg,
                seed,
            )| {
                DensityDocument::Cirrus(CirrusDocument {
                    coverage,
                    cloud_type,
                    optical_depth,
                    map_span_m,
                    fibre_period_m,
                    fibres_towards_deg,
                    seed,
                })
            },
        );
    prop_oneof![weather, homogeneous, grid, cirrus]
}

fn planet() -> impl Strategy<Value = PlanetChoice> {
    prop_oneof![
        Just(PlanetChoice::Flat),
        in_range(ranges::PLANET_RADIUS_M).prop_map(|radius_m| PlanetChoice::Sphere(
            PlanetDocument {
                radius_m,
                ..PlanetDocument::default()
            }
        )),
    ]
}

fn atmosphere() -> impl Strategy<Value = AtmosphereDocument> {
    prop_oneof![
        in_range(ranges::AEROSOL_OPTICAL_DEPTH).prop_map(|aerosol_optical_depth| {
            AtmosphereDocument::Analytic(AnalyticAtmosphereDocument {
                aerosol_optical_depth,
            })
        }),
        in_range(ranges::ENVIRONMENT_RADIANCE).prop_map(|radiance| {
            AtmosphereDocument::Uniform(UniformAtmosphereDocument {
                radiance_w_per_m2_nm_sr: [radiance; 3],
            })
        }),
    ]
}

#[test]
fn a_flat_world_is_null_in_a_document_and_a_word_in_a_patch() {
    for flat in [Value::Null, json!("flat")] {
        let scene = Scene::from_json(&json!({"version": 1, "planet": flat})).expect("flat");
        assert!(scene.planet().is_flat());
        let document = serde_json::to_value(scene.to_document()).expect("serialises");
        assert_eq!(document["planet"], Value::Null);
    }
    let round = Scene::from_json(&json!({"version": 1})).expect("defaults");
    assert!(!round.planet().is_flat());
}

#[test]
fn a_grid_names_a_file_without_folders_and_bounds_with_an_inside() {
    let with = |key: &str, value: Value| {
        let mut grid = json!({"model": "grid", "file": "cloud.f32", "dimensions": [4, 4, 4]});
        grid[key] = value;
        error_of(json!({"version": 1, "layers": [{"density": grid}]})).pointer
    };
    for (key, value, pointer) in [
        ("file", json!(""), "file"),
        ("file", json!("../secret"), "file"),
        ("file", json!("a/b"), "file"),
        ("file", json!(".hidden"), "file"),
        ("file", json!("x".repeat(65)), "file"),
        ("dimensions", json!([0, 1, 1]), "dimensions/0"),
        ("dimensions", json!([1, 1, 2049]), "dimensions/2"),
        ("dimensions", json!([2048, 2048, 2048]), "dimensions"),
        ("bounds_max_m", json!([-500, 2500, 500]), "bounds_max_m/0"),
        ("bounds_min_m", json!([-500, -3e5, 500]), "bounds_min_m/1"),
        ("shape", json!({}), "shape"),
    ] {
        let found = with(key, value);
        assert_eq!(found, format!("/layers/0/density/{pointer}"), "{key}");
    }
}

fn layers() -> impl Strategy<Value = Vec<LayerDocument>> {
    let layer = (
        in_range(ranges::LAYER_ALTITUDE_M),
        in_range(ranges::LAYER_ALTITUDE_M),
        density(),
        in_range(ranges::EXTINCTION_PER_M),
        in_range(ranges::SINGLE_SCATTERING_ALBEDO),
        proptest::option::of(wind()),
        proptest::option::of(proptest::sample::select(Family::ALL.to_vec())),
        proptest::option::of(phase()),
    )
        .prop_map(
            |(
                a_m,
                b_m,
                density,
                extinction_per_m,
                single_scattering_albedo,
                wind,
                family,
                phase,
            )| LayerDocument {
                family,
                phase,
                name: String::new(),
                base_altitude_m: a_m.min(b_m),
                top_altitude_m: a_m.max(b_m),
                density,
                extinction_per_m,
                single_scattering_albedo,
                wind,
            },
        );
    proptest::collection::vec(layer, 0..=ranges::LAYERS_MAX).prop_map(|mut layers| {
        for (index, layer) in layers.iter_mut().enumerate() {
            layer.name = format!("layer {index}");
        }
        layers
    })
}

fn phase() -> impl Strategy<Value = PhaseDocument> {
    prop_oneof![
        Just(PhaseDocument::Ice),
        in_range(ranges::DROPLET_DIAMETER_UM).prop_map(|droplet_diameter_um| {
            PhaseDocument::HgDraine(HgDraineDocument {
                droplet_diameter_um,
            })
        }),
        in_range(ranges::PHASE_G).prop_map(|g| PhaseDocument::Hg(HgDocument { g })),
        (in_range(ranges::PHASE_G), in_range(ranges::DRAINE_ALPHA))
            .prop_map(|(g, alpha)| PhaseDocument::Draine(DraineDocument { g, alpha })),
        Just(PhaseDocument::Isotropic),
    ]
}

proptest! {
    #[test]
    fn a_scene_survives_document_and_json(
        layers in layers(), phase in phase(), wind in wind(), planet in planet(), atmosphere in atmosphere(),
        exposure_ev in in_range(ranges::EXPOSURE_EV), octaves in 1..=16u32,
        budget_ms in proptest::option::of(in_range(crate::quality::BUDGET_MS)),
    ) {
        let document = SceneDocument {
            layers,
            wind,
            exposure_ev,
            quality: budget_ms.map(crate::QualityChoice::BudgetMs),
            planet,
            atmosphere,
            light: LightDocument { phase, octaves, ..LightDocument::default() },
            ..SceneDocument::default()
        };
        let scene = Scene::try_from(document.clone()).expect("every number is in range");
        prop_assert_eq!(&scene.to_document(), &document);
        let text = serde_json::to_string(&document).expect("serialises");
        let read: Value = serde_json::from_str(&text).expect("is JSON");
        prop_assert_eq!(Scene::from_json(&read), Ok(scene));
    }

    #[test]
    fn no_json_makes_reading_a_scene_panic(
        key in prop_oneof![Just("sun".to_owned()), Just("layers".to_owned()), Just("light".to_owned()), ".{0,8}"],
        text in prop_oneof!["[\\[\\]{}0-9\",:a-z]{0,12}", Just("[{\"density\":[]}]".to_owned())],
    ) {
        let inner: Value = serde_json::from_str(&text).unwrap_or(Value::String(text));
        let mut document = serde_json::Map::new();
        document.insert("version".to_owned(), Value::from(1));
        document.insert(key, inner);
        let _ = Scene::from_json(&Value::Object(document));
    }
}

#[test]
fn light_shafts_are_had_in_computed_air_alone() {
    let of = |planet: Value, atmosphere: Value| {
        Scene::from_json(&json!({"version": 1, "planet": planet, "atmosphere": atmosphere}))
    };
    let asked = json!({"model": "physical", "light_shafts": true});
    let sphere = json!({});
    assert!(!Scene::default().light_shafts());
    assert!(of(sphere.clone(), asked.clone()).is_ok_and(|scene| scene.light_shafts()));
    let off = json!({"model": "physical"});
    assert!(of(sphere.clone(), off).is_ok_and(|scene| !scene.light_shafts()));
    let flat = of(Value::Null, asked).expect_err("no air");
    assert_eq!(flat.pointer, "/atmosphere/light_shafts");
    for model in ["analytic", "uniform"] {
        let other = json!({"model": model, "light_shafts": true});
        let error = of(sphere.clone(), other).expect_err("another sky");
        assert_eq!(error.pointer, "/atmosphere/light_shafts");
        assert!(error.allowed.contains(model), "{error}");
    }
}
