use serde_json::json;

use super::*;
use crate::scene::ranges;

fn scene(mut members: Value) -> Scene {
    members["version"] = json!(1);
    Scene::from_json(&members).unwrap_or_else(|error| panic!("{members}: {error}"))
}

fn error_of(mut members: Value) -> SceneError {
    members["version"] = json!(1);
    Scene::from_json(&members).expect_err("must be refused")
}

fn at(unix_s: f64) -> Moment {
    Moment::from_unix_s(unix_s).expect("in range")
}

fn coverage(scene: &Scene) -> f64 {
    match scene.layers()[0].density() {
        crate::scene::DensityModel::Weather(weather) => weather.coverage(),
        other => panic!("{other:?}"),
    }
}

fn rising_coverage(repeat: &str) -> Value {
    json!([{"path": "/layers/0/density/coverage", "repeat": repeat, "keyframes": [
        {"at_s": 0, "value": 0.2}, {"at_s": 60, "value": 1, "ease": "smooth"}, {"at_s": 90, "value": 0.2}
    ]}])
}

#[test]
fn sky_time_is_epoch_and_rate_and_stands_while_paused() {
    for (time, now, expected) in [
        (json!({}), 100.0, 100.0),
        (
            json!({"epoch": 100, "sky_s_at_epoch": 7, "rate": 24}),
            110.0,
            247.0,
        ),
        (json!({"epoch": 100, "rate": -10}), 110.0, -100.0),
        (
            json!({"epoch": 100, "rate": 0, "sky_s_at_epoch": 5}),
            1e6,
            5.0,
        ),
        (json!({"epoch": 100, "paused_at": 103}), 102.0, 2.0),
        (json!({"epoch": 100, "paused_at": 103}), 1e9, 3.0),
        (
            json!({"epoch": 0, "rate": 1e4}),
            30.0 * 86_400.0,
            30.0 * 86_400.0 * 1e4,
        ),
    ] {
        let scene = scene(json!({"time": time}));
        assert_eq!(scene.clock().sky_s(at(now)), expected, "{time}");
    }
}

#[test]
fn a_clock_that_is_changed_goes_on_from_where_it_is() {
    let before = scene(json!({"time": {"epoch": 100, "rate": 24}}));
    let time = TimeDocument::from(before.clock());
    let now = at(160.0);
    let clock = |time: &TimeDocument| SkyClock::try_from(time.clone()).expect("in range");
    let paused = time.changed(
        now,
        &TimeChange {
            paused: Some(true),
            ..Default::default()
        },
    );
    assert_eq!(clock(&paused).sky_s(at(1e9)), 1440.0);
    let later = at(1000.0);
    let resumed = paused.changed(
        later,
        &TimeChange {
            paused: Some(false),
            ..Default::default()
        },
    );
    assert_eq!(clock(&resumed).sky_s(at(1001.0)), 1464.0);
    let slower = resumed.changed(
        at(1001.0),
        &TimeChange {
            rate: Some(1.0),
            ..Default::default()
        },
    );
    assert_eq!(clock(&slower).sky_s(at(1002.0)), 1465.0);
    let set = slower.changed(
        at(1002.0),
        &TimeChange {
            sky_s: Some(-5.0),
            ..Default::default()
        },
    );
    assert_eq!(clock(&set).sky_s(at(1002.0)), -5.0);
}

#[test]
fn the_sun_stands_where_the_solar_position_algorithm_was_published_to_put_it() {
    // Reda & Andreas 2003, the example of the report: zenith 50.11162° and azimuth 194.34024°, both with the refraction
    // and the altitude of 1830 m that we leave out (zenith without refraction 50.12795°).
    let place = PlaceAndTime::try_from(PlaceAndTimeDocument {
        latitude_deg: 39.742_476,
        longitude_deg: -105.1786,
        date: Moment::parse("2003-10-17T12:30:30-07:00", "").expect("a date"),
    })
    .expect("in range");
    let [azimuth, elevation] = place.sun_azimuth_elevation_deg(0.0);
    assert!((azimuth - 194.340_24).abs() < 2e-4, "{azimuth}");
    assert!((elevation - (90.0 - 50.127_95)).abs() < 2e-3, "{elevation}");
}

#[test]
fn the_sun_of_poles_and_of_two_centuries_is_within_its_ranges() {
    for latitude_deg in [-90.0, -66.6, 0.0, 66.6, 90.0] {
        for longitude_deg in [-180.0, 0.0, 180.0] {
            for date in [
                "1900-01-01T00:00:00Z",
                "2026-12-21T12:00:00Z",
                "2100-12-31T23:59:59Z",
            ] {
                let scene = scene(json!({"sun": {"place_and_time": {
                    "latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "date": date
                }}}));
                for sky_s in [0.0, -1e11, 1e11, 1.0, 2_592_000.0] {
                    let sun = *scene.at_sky_s(sky_s).sun();
                    assert!(ranges::AZIMUTH_DEG.contains(sun.azimuth_deg()));
                    assert!(ranges::ELEVATION_DEG.contains(sun.elevation_deg()));
                    assert!((sun.direction().length() - 1.0).abs() < 1e-12);
                }
            }
        }
    }
    // The midnight sun, and the polar night.
    let pole = |date: &str| {
        let place = json!({"latitude_deg": 90, "date": date});
        scene(json!({"sun": {"place_and_time": place}}))
            .at_sky_s(0.0)
            .sun()
            .elevation_deg()
    };
    assert!((pole("2026-06-21T00:00:00Z") - 23.43).abs() < 0.02);
    assert!((pole("2026-12-21T12:00:00Z") + 23.43).abs() < 0.02);
}

#[test]
fn the_moon_of_a_place_follows_it_and_other_moons_stay() {
    let of = |follows: bool| {
        let scene = scene(json!({
            "moon": {"azimuth_deg": 10, "elevation_deg": 20, "phase_angle_deg": 30, "of_place_and_time": follows},
            "sun": {"place_and_time": {"latitude_deg": 48.2, "longitude_deg": 16.4, "date": "2026-06-21T20:00:00Z"}}
        }));
        let places = [0.0, 3_600.0].map(|sky_s| {
            let scene = scene.at_sky_s(sky_s);
            scene.moon().expect("a moon").direction()
        });
        places[0].angle_between(places[1]).to_degrees()
    };
    assert_eq!(of(false), 0.0);
    // Round the Earth in 24 h 50 min, at most.
    let turned = of(true);
    assert!((10.0..15.0).contains(&turned), "{turned}");
}

#[test]
fn an_animated_number_goes_through_its_keyframes_and_leaves_the_document_as_it_is() {
    let scene = scene(json!({"animation": rising_coverage("none")}));
    for (sky_s, expected) in [
        (-1e9, 0.2),
        (0.0, 0.2),
        (30.0, 0.6),
        (60.0, 1.0),
        // A quarter of the way down, 3/16 − 2/64 of it by the smooth ease.
        (67.5, 1.0 - 0.8 * 0.156_25),
        (75.0, 0.6),
        (90.0, 0.2),
        (2_592_000.0, 0.2),
    ] {
        let shown = coverage(&scene.at_sky_s(sky_s));
        assert!((shown - expected).abs() < 1e-12, "{sky_s} s: {shown}");
    }
    assert_eq!(coverage(&scene), 0.45);
    assert_eq!(scene.to_document().animation.len(), 1);
}

#[test]
fn loops_and_ping_pongs_are_continuous_in_both_directions_of_time() {
    for repeat in ["none", "loop", "ping-pong"] {
        let scene = scene(json!({"animation": rising_coverage(repeat)}));
        let animation = &scene.animations()[0];
        let mut before = animation.value_at(-400.0);
        let mut sky_s = -400.0;
        while sky_s < 400.0 {
            sky_s += 0.05;
            let now = animation.value_at(sky_s);
            assert!(
                (now - before).abs() < 0.003,
                "{repeat} at {sky_s}: {before} to {now}"
            );
            before = now;
        }
    }
    let looped = scene(json!({"animation": rising_coverage("loop")}));
    assert!((looped.animations()[0].value_at(-60.0) - 0.6).abs() < 1e-9);
    let swinging = scene(json!({"animation": rising_coverage("ping-pong")}));
    assert!((swinging.animations()[0].value_at(120.0) - 1.0).abs() < 1e-9);
}

#[test]
fn a_single_keyframe_holds_its_value_for_ever() {
    for repeat in ["none", "loop", "ping-pong"] {
        let scene = scene(json!({"animation": [{
            "path": "/exposure_ev", "repeat": repeat, "keyframes": [{"at_s": 5, "value": 2}]
        }]}));
        for sky_s in [-1e9, 0.0, 5.0, 1e9] {
            assert_eq!(scene.at_sky_s(sky_s).exposure_ev(), 2.0);
        }
        assert!(!scene.is_animated_after(at(0.0)));
    }
}

#[test]
fn animations_that_cannot_be_are_refused_where_they_are_wrong() {
    let one = |path: &str, keyframes: Value| json!({"animation": [{"path": path, "keyframes": keyframes}]});
    let ok = json!([{"at_s": 0, "value": 0.5}]);
    let many = |n: u32| {
        Value::from(
            (0..n)
                .map(|i| json!({"at_s": i, "value": 0}))
                .collect::<Vec<_>>(),
        )
    };
    for (document, pointer) in [
        (
            one("/layers/0/density/covrage", ok.clone()),
            "/animation/0/path",
        ),
        (
            one("/layers/1/density/coverage", ok.clone()),
            "/animation/0/path",
        ),
        (one("exposure_ev", ok.clone()), "/animation/0/path"),
        (one("", ok.clone()), "/animation/0/path"),
        (one("/sun", ok.clone()), "/animation/0/path"),
        (one("/light/octaves", ok.clone()), "/animation/0/path"),
        (one("/layers/0/name", ok.clone()), "/animation/0/path"),
        (
            one("/layers/0/density/seed", ok.clone()),
            "/animation/0/path",
        ),
        (
            one("/layers/0/base_altitude_m", ok.clone()),
            "/animation/0/path",
        ),
        (one("/wind/speed_m_per_s", ok.clone()), "/animation/0/path"),
        (one("/planet/radius_m", ok.clone()), "/animation/0/path"),
        (one("/time/rate", ok.clone()), "/animation/0/path"),
        (one("/exposure_ev", json!([])), "/animation/0/keyframes"),
        (one("/exposure_ev", many(65)), "/animation/0/keyframes"),
        (
            one(
                "/exposure_ev",
                json!([{"at_s": 1, "value": 0}, {"at_s": 0, "value": 1}]),
            ),
            "/animation/0/keyframes/1/at_s",
        ),
        (
            one(
                "/exposure_ev",
                json!([{"at_s": 1, "value": 0}, {"at_s": 1, "value": 1}]),
            ),
            "/animation/0/keyframes/1/at_s",
        ),
        (
            one("/exposure_ev", json!([{"at_s": 1e12}])),
            "/animation/0/keyframes/0/at_s",
        ),
        (
            one("/exposure_ev", json!([{"at_s": 1, "velue": 0}])),
            "/animation/0/keyframes/0/velue",
        ),
        (
            one(
                "/exposure_ev",
                json!([{"at_s": 1, "value": 0, "ease": "hold"}]),
            ),
            "/animation/0/keyframes/0/ease",
        ),
        (
            one(
                "/layers/0/density/coverage",
                json!([{"at_s": 0, "value": 0}, {"at_s": 1, "value": 1.01}]),
            ),
            "/animation/0/keyframes/1/value",
        ),
        (
            json!({"animation": [{"path": "/exposure_ev", "repeat": "loop", "keyframes": [
                {"at_s": 0, "value": 0}, {"at_s": 1, "value": 1}]}]}),
            "/animation/0/keyframes/1/value",
        ),
        (
            json!({"animation": [{"path": "/exposure_ev", "keyframes": ok},
                {"path": "/exposure_ev", "keyframes": ok}]}),
            "/animation/1/path",
        ),
        (
            json!({"sun": {"place_and_time": {}}, "animation": [{"path": "/sun/elevation_deg", "keyframes": ok}]}),
            "/animation/0/path",
        ),
        (
            json!({"animation": (0..33).map(|_| json!({})).collect::<Vec<_>>()}),
            "/animation",
        ),
        (json!({"time": {"rate": 1e6}}), "/time/rate"),
        (json!({"time": {"epoch": "yesterday"}}), "/time/epoch"),
        (
            json!({"time": {"sky_s_at_epoch": -1e12}}),
            "/time/sky_s_at_epoch",
        ),
        (
            json!({"sun": {"place_and_time": {"latitude_deg": 91}}}),
            "/sun/place_and_time/latitude_deg",
        ),
        (
            json!({"sun": {"place_and_time": {"date": "1850-01-01T00:00:00Z"}}}),
            "/sun/place_and_time/date",
        ),
        (
            json!({"transition": {"duration_s": -1}}),
            "/transition/duration_s",
        ),
        (
            json!({"transition": {"from": {"version": 1, "exposure_ev": 99}}}),
            "/transition/from/exposure_ev",
        ),
        (
            json!({"transition": {"from": {"version": 1, "transition": {}}}}),
            "/transition/from/transition",
        ),
        (
            json!({"drift": {"since": 0, "layers_m": {"low": [1, 2]}}}),
            "/drift/layers_m/low",
        ),
        (
            json!({"drift": {"since": 0, "layers_m": {"low": [1, 0, 1e300]}}}),
            "/drift/layers_m/low/2",
        ),
    ] {
        assert_eq!(error_of(document.clone()).pointer, pointer, "{document}");
    }
}

#[test]
fn a_document_with_a_timeline_is_written_as_it_was_read() {
    let scene = scene(json!({
        "time": {"epoch": "2026-06-21T10:00:00Z", "rate": 24, "paused_at": "2026-06-21T11:00:00Z", "wind_rate": 1},
        "sun": {"place_and_time": {"latitude_deg": 48.2, "longitude_deg": 16.4, "date": "2026-06-21T04:00:00Z"}},
        "animation": rising_coverage("ping-pong"),
        "transition": {"began": "2026-06-21T10:00:00Z", "duration_s": 10, "from": {"version": 1, "exposure_ev": 2}},
        "drift": {"since": "2026-06-21T10:00:00Z", "layers_m": {"low": [1, 0, -2]}}
    }));
    let value = serde_json::to_value(scene.to_document()).expect("serialises");
    assert_eq!(Scene::from_json(&value), Ok(scene));
}

fn preset_like(extra: Value) -> Value {
    let mut document = json!({
        "sun": {"azimuth_deg": 10, "elevation_deg": 5},
        "layers": [
            {"name": "low", "density": {"coverage": 0.9, "type": 0.1}},
            {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000, "density": {"seed": 3}},
        ],
        "wind": {"towards_deg": 180, "speed_m_per_s": 20}, "exposure_ev": 1,
    });
    for (key, value) in extra.as_object().expect("an object") {
        document[key] = value.clone();
    }
    document
}

/// A transition of ten seconds at 1000 s from a sky with another layer of the name `high`.
fn with_transition() -> (Scene, Scene) {
    let mut from = json!({
        "version": 1, "sun": {"azimuth_deg": 350, "elevation_deg": 45},
        "layers": [
            {"name": "low", "density": {"coverage": 0.3, "type": 0.9}},
            {"name": "high", "base_altitude_m": 5000, "top_altitude_m": 6000, "density": {"seed": 4}},
        ],
        "wind": {"towards_deg": 0, "speed_m_per_s": 10},
    });
    let transition = json!({"began": 1000, "duration_s": 10, "from": from});
    let to = scene(preset_like(json!({"transition": transition})));
    from["time"] = json!({});
    (scene(from), to)
}

#[test]
fn a_transition_begins_with_one_sky_and_ends_with_the_other() {
    let (from, to) = with_transition();
    let whole = |scene: &Scene| {
        let mut document = scene.to_document();
        // The winds of layers are written out while they blend.
        for layer in &mut document.layers {
            layer.wind = None;
        }
        (
            document.layers,
            document.sun,
            document.light,
            document.exposure_ev,
        )
    };
    assert_eq!(whole(&to.at(at(990.0))), whole(&from));
    assert_eq!(whole(&to.at(at(1000.0))), whole(&from));
    assert_eq!(whole(&to.at(at(1010.0))), whole(&to));
    let middle = to.at(at(1005.0));
    assert!((coverage(&middle) - 0.6).abs() < 1e-12);
    assert!(
        middle
            .sun()
            .azimuth_deg()
            .min(360.0 - middle.sun().azimuth_deg())
            < 1e-9,
        "the short way"
    );
    assert!((middle.sun().elevation_deg() - 25.0).abs() < 1e-12);
    assert!(to.is_animated_after(at(1009.9)) && !to.is_animated_after(at(1010.0)));
}

#[test]
fn layers_of_other_patterns_change_places_while_they_are_not_seen() {
    let (_, to) = with_transition();
    let seed = |scene: &Scene| match scene.layers()[1].density() {
        crate::scene::DensityModel::Weather(weather) => weather.seed(),
        other => panic!("{other:?}"),
    };
    let just_before = to.at(at(1004.999));
    let just_after = to.at(at(1005.0));
    assert_eq!((seed(&just_before), seed(&just_after)), (4, 3));
    for scene in [&just_before, &just_after] {
        let extinction = scene.layers()[1].extinction_per_m();
        assert!(extinction > 0.0 && extinction < 1e-7, "{extinction}");
    }
}

/// The largest change of any number between moments a hundredth of a second apart, over a transition of ten seconds.
fn largest_jump(sky_at: impl Fn(Moment) -> Scene) -> f64 {
    let numbers = |now: Moment| {
        let scene = sky_at(now);
        let extinction = |index: usize| 10.0 * scene.layers()[index].extinction_per_m();
        [
            coverage(&scene),
            extinction(0),
            extinction(1),
            scene.sun().elevation_deg() / 45.0,
            scene.sun().direction().x,
            scene.exposure_ev(),
            scene.carried_m(0).x / 100.0,
            scene.carried_m(0).z / 100.0,
            scene.carried_m(1).z / 100.0,
        ]
    };
    let mut largest: f64 = 0.0;
    let mut before = numbers(at(999.0));
    for step in 1..1200 {
        let now = numbers(at(999.0 + f64::from(step) * 0.01));
        for (a, b) in before.iter().zip(now) {
            largest = largest.max((a - b).abs());
        }
        before = now;
    }
    largest
}

/// A hundredth of what changes in the whole transition.
const JUMP_MAX: f64 = 0.01;

#[test]
fn every_number_of_a_transition_is_continuous_and_so_are_the_clouds() {
    let (_, to) = with_transition();
    let jump = largest_jump(|now| to.at(now));
    println!("largest change in 10 ms: {jump:.5}");
    assert!(jump < JUMP_MAX, "{jump}");
}

#[test]
fn planted_jumps_are_noticed() {
    let (from, to) = with_transition();
    let defects: [(&str, &dyn Fn(Moment) -> Scene); 3] = [
        ("a switch in the middle", &|now| {
            if now < at(1005.0) {
                from.at(now)
            } else {
                to.at(at(1010.0))
            }
        }),
        ("a transition that ends too early", &|now| {
            if now < at(1009.0) {
                to.at(now)
            } else {
                to.at(at(1011.0))
            }
        }),
        ("wind of the new sky from the beginning", &|now| {
            let carried = to.at(if now < at(1000.0) {
                now
            } else {
                now.plus_s(now.seconds_since(at(1000.0)))
            });
            to.at(now).carried_like(&carried)
        }),
    ];
    for (what, defect) in defects {
        let jump = largest_jump(defect);
        let caught = jump > JUMP_MAX || {
            // Faster clouds are no jump but a wrong place at the end.
            let (is, should) = (defect(at(1010.0)), to.at(at(1010.0)));
            is.carried_m(0).distance(should.carried_m(0)) > 1.0
        };
        assert!(caught, "{what}: {jump}");
    }
}

#[test]
fn a_transition_can_be_left_in_its_middle_without_a_jump() {
    let (_, to) = with_transition();
    let now = at(1003.0);
    let shown = to.at(now);
    let mut third = preset_like(json!({"exposure_ev": -2, "layers": []}));
    let mut from = serde_json::to_value(shown.to_document()).expect("serialises");
    for key in transition::TIMELINE_KEYS {
        from.as_object_mut().expect("an object").remove(key);
    }
    third["transition"] = json!({"began": 1003, "duration_s": 4, "from": from});
    let third = scene(third);
    let document = |scene: &Scene| (scene.to_document().layers, scene.to_document().sun);
    assert_eq!(document(&third.at(now)), document(&shown));
    assert_eq!(third.at(at(1007.0)).layers().len(), 0);
}

#[test]
fn changes_of_wind_and_clock_do_not_move_the_clouds() {
    let wind = |speed: f64| json!({"towards_deg": 90, "speed_m_per_s": speed});
    let before = scene(json!({"wind": wind(5.0), "time": {"epoch": 1000}}));
    let now = at(5000.0);
    let mut document = scene(json!({"wind": wind(15.0), "time": {"epoch": 1000}})).to_document();
    let next = Scene::try_from(document.clone()).expect("a scene");
    document.drift = before.continued_drift(&next, now);
    let next = Scene::try_from(document).expect("a scene");
    let place = |scene: &Scene, unix_s: f64| scene.at(at(unix_s)).carried_m(0).x;
    assert!((place(&before, 5000.0) - 20_000.0).abs() < 1e-6);
    assert!((place(&next, 5000.0) - 20_000.0).abs() < 1e-6);
    assert!((place(&next, 5002.0) - 20_030.0).abs() < 1e-6);
    // The clock is set back by an hour and stopped: the same.
    let mut document = next.to_document();
    let change = TimeChange {
        sky_s: Some(400.0),
        paused: Some(true),
        ..Default::default()
    };
    document.time = document.time.changed(at(5002.0), &change);
    let stopped = Scene::try_from(document.clone()).expect("a scene");
    document.drift = next.continued_drift(&stopped, at(5002.0));
    let stopped = Scene::try_from(document).expect("a scene");
    for unix_s in [5002.0, 1e6, 4e9] {
        assert!(
            (place(&stopped, unix_s) - 20_030.0).abs() < 1e-6,
            "{unix_s}"
        );
    }
    assert_eq!(stopped.wind_rate_at(at(5003.0)), 0.0);
}

#[test]
fn wind_may_keep_its_pace_while_a_day_passes_in_an_hour() {
    let scene = scene(
        json!({"time": {"rate": 24, "wind_rate": 1}, "wind": {"towards_deg": 90, "speed_m_per_s": 5}}),
    );
    assert_eq!(scene.clock().sky_s(at(100.0)), 2400.0);
    assert!((scene.at(at(100.0)).carried_m(0).x - 500.0).abs() < 1e-9);
}

#[test]
fn a_still_scene_is_not_animated_and_costs_no_evaluation() {
    assert!(!Scene::default().is_animated_after(at(1e9)));
    let by_place = |time: Value| scene(json!({"sun": {"place_and_time": {}}, "time": time}));
    assert!(by_place(json!({})).is_animated_after(at(1e9)));
    assert!(!by_place(json!({"rate": 0})).is_animated_after(at(1e9)));
    assert!(!by_place(json!({"paused_at": 5})).is_animated_after(at(1e9)));
    let once = scene(json!({"animation": rising_coverage("none")}));
    assert!(once.is_animated_after(at(89.0)) && !once.is_animated_after(at(90.0)));
}

#[test]
fn two_readers_of_a_document_see_the_same_sky_at_the_same_moment() {
    let (_, to) = with_transition();
    let value = serde_json::to_value(to.to_document()).expect("serialises");
    let other = Scene::from_json(&value).expect("a scene");
    for unix_s in [0.0, 1_001.234_567, 1005.0, 1008.0, 2e9] {
        assert_eq!(to.at(at(unix_s)), other.at(at(unix_s)));
    }
}
