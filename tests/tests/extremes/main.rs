//! Every parameter at its ends and past them, on the renderer that makes the frames: no NaN, no infinity, nothing
//! negative, and a bound per case against a closed form, or against what must be the same picture.
//!
//! Each line prints its number of cases and how near the worst came to its bound (`-- --nocapture`).

mod air;
mod camera;
mod depth;
mod documents;
mod fields;
mod frames;
mod layers;
mod line;
mod looks;
mod maps;
mod octaves;
mod phase;
mod place;
mod planted;
mod scattering;
mod sheets;
mod shells;
mod stage;
mod steps;
mod sun;
mod sun_volume;
mod time;
mod truth;
mod window;

use line::Line;
use stage::{Stage, stage};

type Run = fn(&mut Stage) -> Line;

/// How many cases each line has.
const CASES: [(Run, usize); 35] = [
    (sun::anywhere, 102),
    (sun::along_the_ray, 8),
    (camera::anywhere, 92),
    (shells::grazed, 108),
    (depth::any, 51),
    (layers::any, 18),
    (fields::coverage, 24),
    (fields::grids, 15),
    (phase::sharpest, 30),
    (octaves::any, 132),
    (steps::any, 16),
    (place::anywhere_and_anytime, 18),
    (frames::any, 12),
    (steps::accumulated, 8),
    (truth::at_the_ends, 64),
    (maps::any, 42),
    (maps::blends, 10),
    (maps::refused, 4),
    (maps::evolution, 5),
    (maps::mixed, 1),
    (sheets::anywhere, 66),
    (time::any_clock, 12),
    (sun_volume::anywhere, 32),
    (sun_volume::through_slabs, 33),
    (window::any, 39),
    (scattering::any, 135),
    (scattering::furnace, 18),
    (looks::night, 33),
    (looks::tone, 24),
    (looks::views, 58),
    (documents::fields, 50),
    (documents::light, 28),
    (documents::timelines, 41),
    (air::opaque, 3),
    (air::anywhere, 14),
];

fn check(index: usize) {
    let (run, cases) = CASES[index];
    run(&mut stage()).finish(cases);
}

#[test]
fn there_are_at_least_three_hundred_cases() {
    let sum: usize = CASES.iter().map(|(_, cases)| cases).sum();
    println!("{sum} cases");
    assert!(sum >= 300);
}

macro_rules! lines {
    ($($name:ident = $index:expr;)*) => {$(
        #[test]
        fn $name() { check($index); }
    )*};
}

lines! {
    the_sun_may_stand_anywhere_and_at_night_all_is_black = 0;
    the_sun_seen_along_a_ray_has_its_irradiance = 1;
    the_camera_may_stand_and_look_anywhere = 2;
    rays_that_graze_a_shell_cross_what_they_graze = 3;
    clouds_may_be_thin_as_nothing_or_solid_as_rock = 4;
    layers_may_be_flat_empty_solid_or_in_one_another = 5;
    coverage_may_be_nothing_or_all = 6;
    grids_may_have_any_edge_and_hold_nothing_but_densities = 7;
    phases_may_be_as_sharp_as_the_document_allows = 8;
    octaves_may_be_one_to_sixteen_of_any_factor = 9;
    steps_may_be_one_or_thousands = 10;
    clouds_are_the_same_from_every_cell_and_after_a_month = 11;
    frames_may_have_any_size_of_the_document = 12;
    a_mean_of_a_hundred_thousand_frames_does_not_drift = 13;
    pictures_at_the_ends_are_the_references_to_a_thousandth = 14;
    maps_may_have_any_side_any_constant_and_sixteen_bits = 15;
    a_blend_begins_at_the_old_sky_and_ends_at_the_new_one = 16;
    files_that_hold_no_coverages_are_refused_by_their_value = 17;
    noise_may_rise_for_a_month = 18;
    maps_on_their_way_are_the_references_mix = 19;
    sheets_may_be_seen_from_anywhere_even_along_them = 20;
    clocks_may_stand_race_and_run_backwards_at_any_place = 21;
    the_sun_volume_serves_any_sun_place_and_time = 22;
    the_sun_volume_holds_slabs_and_what_stands_above_them = 23;
    windows_may_turn_cut_rest_and_last = 24;
    light_that_is_scattered_often_is_the_twins_in_any_cloud = 25;
    clouds_cannot_be_seen_in_a_furnace = 26;
    nights_may_have_any_moon_and_any_stars = 27;
    curves_go_from_black_to_white_at_any_exposure = 28;
    every_view_may_be_looked_at_from_anywhere = 29;
    families_and_fields_may_have_any_pattern_and_period = 30;
    light_in_clouds_may_be_none_or_all = 31;
    clocks_transitions_keyframes_and_drifts_may_stand_at_their_ends = 32;
    opaque_air_sends_back_what_comes = 33;
    air_may_be_of_any_kind_and_amount_around_any_planet = 34;
}
