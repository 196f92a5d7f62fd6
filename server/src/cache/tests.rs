use super::*;
use proptest::prelude::*;
use std::collections::HashSet;

const SPHERE: SphereId = SphereId {
    cell: CellId(1),
    proxy: 0,
};

fn request(key: TileKey) -> TileRequest {
    TileRequest {
        key,
        eccentricity_rad: 0.1,
        distance_m: 3_000.0,
        screen_share: 0.1,
        texel_pixels: 1.0,
    }
}

fn tile(level: u8, x: u16, y: u16) -> TileKey {
    TileKey { level, x, y }
}

fn at_origin(_: SphereId) -> Option<DVec3> {
    Some(DVec3::ZERO)
}

fn updates_until_converged(caches: &mut Caches) -> usize {
    let mut count = 0;
    loop {
        let updates = caches.plan(3, at_origin);
        if updates.is_empty() {
            return count;
        }
        count += updates.len();
    }
}

#[test]
fn viewers_of_one_cell_share_every_texel_they_both_see() {
    let tiles: Vec<TileRequest> = (0..10).map(|x| request(tile(2, x, 5))).collect();
    let updates = |viewers: usize| {
        let mut caches = Caches::new(100, 8);
        let requests: Vec<&TileRequest> = (0..viewers).flat_map(|_| &tiles).collect();
        caches.sphere_mut(SPHERE).set_wanted(&[], requests);
        updates_until_converged(&mut caches)
    };
    assert_eq!(updates(1), 80);
    assert_eq!(updates(16), 80);
}

#[test]
fn a_converged_sky_needs_no_update_until_the_scene_changes() {
    let mut caches = Caches::new(100, 8);
    let tiles = [request(tile(1, 0, 0)), request(tile(1, 1, 0))];
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    assert_eq!(updates_until_converged(&mut caches), 16);
    assert!(!caches.has_work(at_origin));
    caches.age_all();
    assert!(caches.has_work(at_origin));
    // What is shown stays shown while it is marched anew.
    let tables = caches.sphere_mut(SPHERE).page_tables(None);
    assert_ne!(tables.entries[tables.level_offsets[1] as usize], NO_TILE);
    assert_eq!(updates_until_converged(&mut caches), 16);
}

#[test]
fn the_first_sample_of_a_generation_replaces_and_the_nth_weighs_one_nth() {
    let mut caches = Caches::new(4, 8);
    caches
        .sphere_mut(SPHERE)
        .set_wanted(&[], &[request(tile(0, 1, 1))]);
    for round in 0..2 {
        for n in 1..=8u32 {
            let update = caches.plan(1, at_origin)[0];
            assert_eq!(update.sample_index, n - 1);
            assert!((update.weight - 1.0 / n as f32).abs() < 1e-7, "{round} {n}");
        }
        caches.age_all();
    }
}

#[test]
fn a_reference_that_moves_ages_near_tiles_first_and_far_ones_not_at_all() {
    let mut caches = Caches::new(10, 2);
    let near = TileRequest {
        distance_m: 2_000.0,
        ..request(tile(1, 0, 0))
    };
    let far = TileRequest {
        distance_m: 200_000.0,
        ..request(tile(1, 5, 5))
    };
    caches.sphere_mut(SPHERE).set_wanted(&[], &[near, far]);
    updates_until_converged(&mut caches);
    let moved = |_| Some(DVec3::new(50.0, 0.0, 0.0));
    for _ in 0..2 {
        let updates = caches.plan(10, moved);
        assert_eq!(updates.len(), 1);
        assert_eq!(updates[0].key, near.key);
    }
}

/// Where a tile's texels were marched from, as shares of the mixture.
#[derive(Default)]
struct Mixture(Vec<(DVec3, f64)>);

impl Mixture {
    fn take(&mut self, update: &TileUpdate, reference: DVec3) {
        let weight = f64::from(update.weight);
        for (_, share) in &mut self.0 {
            *share *= 1.0 - weight;
        }
        self.0.push((reference, weight));
    }

    fn share_from(&self, reference: DVec3) -> f64 {
        let from = self.0.iter().filter(|(place, _)| *place == reference);
        from.map(|(_, share)| share).sum()
    }
}

#[test]
fn after_a_jump_what_is_old_weighs_a_seventeenth_at_most_or_is_a_pixel_off() {
    // A jump from the ground to 1.5 km, seen from tiles of any distance.
    let jump_m = DVec3::Y * 1500.0;
    for distance_m in [3e3, 2e4, 2.6e4, 4e4, 8e4, 1.2e5, 3e5, 4e5, 6e5] {
        let mut caches = Caches::new(4, 8);
        let wanted = TileRequest {
            distance_m,
            ..request(tile(1, 0, 0))
        };
        caches.sphere_mut(SPHERE).set_wanted(&[], &[wanted]);
        let mut mixture = Mixture::default();
        while let [update] = caches.plan(1, at_origin)[..] {
            mixture.take(&update, DVec3::ZERO);
        }
        let mut samples = 0;
        while let [update] = caches.plan(1, |_| Some(jump_m))[..] {
            mixture.take(&update, jump_m);
            samples += 1;
            let sphere = caches.sphere(SPHERE).expect("there");
            assert_eq!(
                sphere.pending_samples(TexelSamples::each(8)),
                8 - samples,
                "{distance_m}"
            );
        }
        let angle = 1500.0 / distance_m / sphere::AGE_STEP_RAD;
        let old = mixture.share_from(DVec3::ZERO);
        println!("{distance_m} m, {angle:.2} steps: {samples} samples, {old:.3} old");
        let expected = match angle {
            _ if angle > sphere::AGE_RESTART => (8, 0.0),
            _ if angle > sphere::AGE_REST => (8, 1.0 / 17.0),
            _ => (0, 1.0),
        };
        assert_eq!(samples, expected.0, "{distance_m}");
        assert!((old - expected.1).abs() < 1e-6, "{distance_m} m: {old}");
        assert!(old * angle < sphere::AGE_REST, "{distance_m} m: {old}");
        // All new samples weigh the same: their mean is the middle of the texel.
        let last = mixture.0.last().expect("a sample").1;
        for (_, share) in mixture.0.iter().filter(|(place, _)| *place == jump_m) {
            assert!((share - last).abs() < 1e-6);
        }
    }
}

#[test]
fn under_wind_a_tile_is_seen_from_half_a_step_away_at_most_however_long_it_blows() {
    let wanted = request(tile(1, 0, 0));
    let step_m = sphere::AGE_STEP_RAD * wanted.distance_m;
    // A breeze, and a storm in which a tile's turn comes once in two steps.
    for (way, bound) in [(0.01, 0.52), (2.0, 1.51)] {
        let mut caches = Caches::new(4, 8);
        let mut from = DVec3::ZERO;
        let mut samples = 0.0;
        let rounds = 4_000;
        for round in 0..rounds {
            let reference = DVec3::X * f64::from(round) * way * step_m;
            let sphere = caches.sphere_mut(SPHERE);
            sphere.set_wanted(&[], &[wanted]);
            sphere.set_drifts(true, DVec3::X);
            for update in caches.plan(1, |_| Some(reference)) {
                assert!(round < 8 || update.weight >= 0.25);
                // What is there is carried over from where it was seen from.
                assert!(round == 0 || update.old_from == from);
                from = update.from;
                samples += 1.0;
            }
            let off = (reference - from).length() / step_m;
            assert!(off <= bound, "{way}: {off} steps in round {round}");
        }
        let per_step = samples / (f64::from(rounds) * way);
        println!("{per_step:.2} samples a step at {way} steps a turn");
        assert!(per_step < 1.2, "{per_step}");
    }
}

/// Tiles with all their samples, in clouds that drift; the reference then goes so far, in steps of the nearest.
fn drifting(wanted: &[TileRequest]) -> Caches {
    let mut caches = Caches::new(100, 8);
    caches.sphere_mut(SPHERE).set_wanted(&[], wanted);
    updates_until_converged(&mut caches);
    caches.sphere_mut(SPHERE).set_drifts(true, DVec3::X);
    caches
}

#[test]
fn the_largest_expected_gain_comes_first_and_what_more_people_see_before_what_fewer_see() {
    let at = |x: u16, distance_m: f64| TileRequest {
        distance_m,
        ..request(tile(1, x, 0))
    };
    let (near, far, shared) = (at(0, 2_000.0), at(1, 4_000.0), at(2, 3_000.0));
    let mut caches = drifting(&[near, far, shared]);
    let fresh = at(3, 4_000.0);
    let wanted = [near, far, shared, shared, shared, fresh];
    caches.sphere_mut(SPHERE).set_wanted(&[], &wanted);
    let reference = DVec3::X * 2.0 * sphere::AGE_STEP_RAD * far.distance_m;
    let planned = |caches: &mut Caches, tiles: usize| -> Vec<TileKey> {
        let updates = caches.plan(tiles, |_| Some(reference));
        updates.iter().map(|update| update.key).collect()
    };
    // What was never marched, then what three see, then the nearest, then the one that is only noisy or far.
    assert_eq!(
        planned(&mut caches, 4),
        [fresh.key, shared.key, near.key, far.key]
    );
    // All have been seen to; one lacks samples.
    assert_eq!(planned(&mut caches, 4), [fresh.key]);
}

#[test]
fn a_tile_in_which_audits_find_nothing_is_marched_four_times_as_seldom_and_one_that_changes_most_twice_as_often()
 {
    let tiles: Vec<TileRequest> = (0..3).map(|x| request(tile(1, x, 0))).collect();
    let step_m = sphere::AGE_STEP_RAD * tiles[0].distance_m;
    let marched = || {
        let mut caches = drifting(&tiles);
        for _ in 0..100 {
            caches.note_audit(SPHERE, &tiles[0].key, 1.0, 0.0);
            caches.note_audit(SPHERE, &tiles[2].key, 1.0, 1e9);
            // What is no number says nothing.
            caches.note_audit(SPHERE, &tiles[1].key, 1.0, f64::NAN);
        }
        let mut updates = Vec::new();
        for round in 0..4_000 {
            let reference = DVec3::X * f64::from(round) * 0.01 * step_m;
            updates.extend(caches.plan(1, |_| Some(reference)));
        }
        updates
    };
    let updates = marched();
    let counts = [0, 1, 2].map(|i| updates.iter().filter(|u| u.key == tiles[i].key).count());
    println!("{counts:?} samples in 40 steps");
    for (count, expected) in counts.into_iter().zip([10, 40, 80]) {
        assert!(count.abs_diff(expected) <= expected / 10 + 1, "{counts:?}");
    }
    assert_eq!(updates, marched(), "the same input, the same updates");
}

#[test]
fn counts_of_samples_may_go_round() {
    let mut caches = Caches::new(1, 8);
    let wanted = [request(tile(1, 0, 0))];
    caches.sphere_mut(SPHERE).set_wanted(&[], &wanted);
    updates_until_converged(&mut caches);
    for visits in [1 << 16, 1 << 24, 1 << 31, u32::MAX] {
        caches.sphere_mut(SPHERE).set_visits(visits - 3);
        for _ in 0..8 {
            caches.refresh_all();
            let updates = caches.plan(1, at_origin);
            assert!(updates.len() == 1 && updates[0].sample_index < 8);
            assert_eq!(updates[0].weight, 0.25);
            // A count of 0 would mean that there is nothing to show.
            let tables = caches.sphere_mut(SPHERE).page_tables(None);
            assert_ne!(tables.entries[tables.level_offsets[1] as usize], NO_TILE);
        }
    }
}

#[test]
fn a_wanted_tile_gets_the_slot_of_the_one_unseen_for_longest_and_wanted_ones_keep_theirs() {
    let mut caches = Caches::new(3, 1);
    let look_at = |caches: &mut Caches, xs: &[u16]| {
        let tiles: Vec<_> = xs.iter().map(|x| request(tile(1, *x, 0))).collect();
        caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
        let updates = caches.plan(9, at_origin);
        caches.frame_shown(SPHERE.cell);
        updates.len()
    };
    let holds = |caches: &Caches, x: u16| {
        let sphere = caches.sphere(SPHERE).expect("there");
        sphere.tiles.contains_key(&tile(1, x, 0))
    };
    assert_eq!(look_at(&mut caches, &[0]), 1);
    assert_eq!(look_at(&mut caches, &[1]), 1);
    assert_eq!(look_at(&mut caches, &[2]), 1);
    // Nobody looks at 0 and 1 any more; 0 was seen first.
    assert_eq!(look_at(&mut caches, &[2, 3]), 1);
    assert_eq!(
        [0, 1, 2, 3].map(|x| holds(&caches, x)),
        [false, true, true, true]
    );
    assert_eq!(caches.evicted(), 1);
    // More than there is room for, which budgets see to that it is not asked for.
    assert_eq!(look_at(&mut caches, &[2, 3, 4, 5]), 1);
    assert_eq!(caches.refused(), 1);
    assert!(holds(&caches, 2) && holds(&caches, 3));
    assert_eq!(caches.resident(), 3);
}

#[test]
fn a_cell_at_its_limit_replaces_its_own_tiles_and_no_others() {
    let other = SphereId {
        cell: CellId(2),
        ..SPHERE
    };
    let mut caches = Caches::new(100, 1);
    caches.set_cell_tiles_max(4);
    let tiles = |from: u16, count: u16| -> Vec<TileRequest> {
        (from..from + count)
            .map(|x| request(tile(2, x, 0)))
            .collect()
    };
    caches.sphere_mut(other).set_wanted(&[], &tiles(0, 3));
    for from in [0, 4, 8] {
        caches.sphere_mut(SPHERE).set_wanted(&[], &tiles(from, 4));
        updates_until_converged(&mut caches);
        let resident = |id| caches.sphere(id).map_or(0, SphereCache::resident);
        assert_eq!([SPHERE, other].map(resident), [4, 3]);
    }
    assert_eq!((caches.evicted(), caches.refused()), (8, 0));
}

#[test]
fn what_is_seen_most_is_marched_first_and_the_coarse_level_under_it_before() {
    let mut caches = Caches::new(100, 1);
    let at = |x: u16, eccentricity_rad: f64, screen_share: f64| TileRequest {
        eccentricity_rad,
        screen_share,
        ..request(tile(1, x, 0))
    };
    let coarse: Vec<TileRequest> = (0..5)
        .map(|x| TileRequest {
            screen_share: 0.0,
            ..request(tile(0, x, 0))
        })
        .collect();
    // 2: in the middle of a picture; 9: as near, of three pictures; 6: at a rim; 7: at a rim, larger.
    let [middle, of_three] = [at(2, 0.05, 0.1), at(9, 0.05, 0.1)];
    let rims = [at(6, 0.5, 0.1), at(7, 0.5, 0.2)];
    let asked = [middle, of_three, of_three, of_three, rims[0], rims[1]];
    caches.sphere_mut(SPHERE).set_wanted(&coarse, &asked);
    let order: Vec<TileKey> = std::iter::repeat_with(|| caches.plan(1, at_origin))
        .map_while(|updates| Some(updates.first()?.key))
        .collect();
    let xs = |level: u8| -> Vec<u16> {
        let of_level = order.iter().filter(|key| key.level == level);
        of_level.map(|key| key.x).collect()
    };
    assert_eq!(xs(1), [9, 2, 7, 6]);
    assert_eq!(xs(0), [4, 3, 1, 0, 2]);
    assert!(order[..5].iter().all(|key| key.level == 0), "{order:?}");
}

#[test]
fn a_cell_that_ends_gives_back_every_slot() {
    let mut caches = Caches::new(50, 1);
    let tiles: Vec<_> = (0..7).map(|x| request(tile(2, x, 0))).collect();
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    caches.plan(50, at_origin);
    assert_eq!(caches.resident(), 7);
    caches.remove_cell(SPHERE.cell);
    assert_eq!(caches.resident(), 0);
    assert_eq!(caches.slots_needed(), 0);
}

#[test]
fn a_missing_tile_is_shown_by_the_nearest_coarser_one() {
    let mut caches = Caches::new(50, 1);
    let coarse = [request(tile(0, 2, 2))];
    let fine = [request(tile(2, 8, 8))];
    caches.sphere_mut(SPHERE).set_wanted(&coarse, &fine);
    caches.plan(50, at_origin);
    let tables = caches.sphere_mut(SPHERE).page_tables(None);
    let side = TileKey::tiles_per_side(2) as usize;
    let entry =
        |x: usize, y: usize| tables.entries[tables.level_offsets[2] as usize + y * side + x];
    assert_eq!(entry(8, 8) >> 16, 2);
    assert_eq!(entry(9, 8) >> 16, 0);
    assert_eq!(entry(0, 0), NO_TILE);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    /// Random viewers look at random tiles: slots are never shared, the budget holds, and what is wanted and fits is
    /// there.
    #[test]
    fn slots_have_one_owner_and_the_budget_holds(
        limit in 4u32..40,
        steps in proptest::collection::vec((0u16..10, 0u16..10, 1u16..5, 0u32..3), 1..60),
    ) {
        let mut caches = Caches::new(limit, 2);
        for (x, y, count, layer) in steps {
            let id = SphereId { cell: CellId(1 + layer), proxy: 0 };
            let wanted: Vec<_> = (0..count).map(|i| request(tile(1, (x + i) % 10, y))).collect();
            caches.sphere_mut(id).set_wanted(&[], &wanted);
            let updates = caches.plan(8, at_origin);
            caches.frame_shown(id.cell);
            let mut owners = HashSet::new();
            for sphere in caches.spheres.values() {
                for tile in sphere.tiles.values() {
                    prop_assert!(owners.insert(tile.slot));
                    prop_assert!(tile.slot.0 < limit);
                }
            }
            prop_assert_eq!(owners.len() as u32, caches.resident());
            let distinct: HashSet<_> = updates.iter().map(|u| (u.sphere, u.key)).collect();
            prop_assert_eq!(distinct.len(), updates.len(), "one sample a tile and plan");
        }
    }
}

#[test]
fn a_small_change_takes_one_sample_of_every_tile_and_keeps_what_it_shows() {
    let mut caches = Caches::new(100, 8);
    let tiles = [request(tile(1, 0, 0)), request(tile(1, 1, 0))];
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    assert!(!caches.is_refreshed());
    assert_eq!(updates_until_converged(&mut caches), 16);
    assert!(caches.is_refreshed());
    caches.refresh_all();
    assert!(!caches.is_refreshed());
    for update in caches.plan(9, at_origin) {
        assert!(update.weight < 0.5, "{}", update.weight);
    }
    assert!(caches.is_refreshed());
    assert!(!caches.has_work(at_origin));
}

#[test]
fn noise_that_rises_ages_tiles_as_a_reference_that_moves_as_far() {
    let mut caches = Caches::new(100, 8);
    let wanted = request(tile(1, 0, 0));
    caches.sphere_mut(SPHERE).set_wanted(&[], &[wanted]);
    updates_until_converged(&mut caches);
    caches.sphere_mut(SPHERE).set_drifts(true, DVec3::ZERO);
    let step_m = sphere::AGE_STEP_RAD * wanted.distance_m;
    let refresh_m = sphere::AGE_DRIFTING * step_m;
    caches.sphere_mut(SPHERE).set_evolved(0.99 * refresh_m);
    assert!(!caches.has_work(at_origin));
    caches.sphere_mut(SPHERE).set_evolved(1.01 * refresh_m);
    let updates = caches.plan(9, at_origin);
    assert!(updates.len() == 1 && updates[0].weight < 0.5);
    assert!(!caches.has_work(at_origin));
    // So far that old and new samples show other clouds.
    let restart_m = sphere::AGE_RESTART * step_m;
    caches
        .sphere_mut(SPHERE)
        .set_evolved(1.01 * (refresh_m + restart_m));
    assert_eq!(caches.plan(9, at_origin)[0].weight, 1.0);
    // A reference that rises with the noise does not hide it.
    updates_until_converged(&mut caches);
    caches
        .sphere_mut(SPHERE)
        .set_evolved(3.0 * (refresh_m + restart_m));
    let risen = move |_: SphereId| Some(DVec3::Y * 2.0 * (refresh_m + restart_m));
    assert!(caches.has_work(risen));
}

fn way(steps: f64) -> SkyWay {
    SkyWay {
        steps,
        percent: 0.4 * steps,
    }
}

#[test]
fn of_two_skies_that_have_moved_as_far_the_one_that_shows_more_comes_first() {
    let mut caches = Caches::new(4, 1);
    let [sun, cover] = [0, 1].map(|proxy| SphereId { proxy, ..SPHERE });
    for sphere in [sun, cover] {
        caches
            .sphere_mut(sphere)
            .set_wanted(&[], &[request(tile(1, 0, 0))]);
    }
    updates_until_converged(&mut caches);
    caches.set_calm(false);
    let [of_sun, of_cover] = [0.1, 2.0].map(|rate| SkyWay {
        steps: 4.0,
        percent: 4.0 * rate,
    });
    for (ways, first) in [([of_sun, of_cover], cover), ([of_cover, of_sun], sun)] {
        caches.age_by(&ways);
        let expected = |sphere| {
            let cache = caches.sphere(sphere).expect("there");
            cache
                .expected(&tile(1, 0, 0), DVec3::ZERO)
                .expect("a tile")
                .0
        };
        println!("{} {}", expected(sun), expected(cover));
        assert_eq!(caches.plan(1, at_origin)[0].sphere, first);
        assert_eq!(caches.plan(1, at_origin).len(), 1);
        assert!(caches.plan(1, at_origin).is_empty());
    }
}

#[test]
fn a_sky_that_moves_mixes_its_tiles_towards_the_present_and_then_rests() {
    let mut caches = Caches::new(4, 8);
    let tiles = [request(tile(1, 0, 0)), request(tile(1, 1, 0))];
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    updates_until_converged(&mut caches);
    caches.set_calm(false);
    caches.age_by(&[way(0.9)]);
    assert!(caches.plan(2, at_origin).is_empty(), "nobody sees it yet");
    caches.age_by(&[way(0.9)]);
    let updates = caches.plan(2, at_origin);
    assert_eq!(updates.len(), 2);
    for update in &updates {
        let expected = (1.0 - 0.75 / 1.8) as f32;
        assert!((update.weight - expected).abs() < 1e-6, "{}", update.weight);
    }
    assert!(
        caches.plan(2, at_origin).is_empty(),
        "less than a step is left"
    );
    // At rest what is left of the past goes, by a quarter each time: 0.75 · 0.75^n < 0.05.
    caches.set_calm(true);
    assert_eq!(updates_until_converged(&mut caches), 2 * 10);
    let sphere = caches.sphere(SPHERE).expect("there");
    assert_eq!(sphere.pending_samples(TexelSamples::each(8)), 0);
}

#[test]
fn a_sky_far_from_the_one_that_was_marched_starts_anew() {
    let mut caches = Caches::new(4, 8);
    caches
        .sphere_mut(SPHERE)
        .set_wanted(&[], &[request(tile(1, 0, 0))]);
    updates_until_converged(&mut caches);
    caches.age_by(&[way(1000.0)]);
    let update = caches.plan(1, at_origin)[0];
    assert_eq!((update.weight, update.sample_index), (1.0, 0));
    assert_eq!(updates_until_converged(&mut caches), 7);
}

#[test]
fn layers_that_stay_keep_their_tiles_and_those_that_go_give_them_back() {
    let id = |proxy| SphereId {
        cell: CellId(1),
        proxy,
    };
    let mut caches = Caches::new(10, 1);
    for layer in 0..3 {
        let tiles: Vec<TileRequest> = (0..=layer as u16).map(|x| request(tile(1, x, 0))).collect();
        caches.sphere_mut(id(layer)).set_wanted(&[], &tiles);
    }
    updates_until_converged(&mut caches);
    assert_eq!(caches.resident(), 6);
    // The last comes first, a new one is second, the first third; the middle one goes.
    caches.keep_proxies(CellId(1), &[Some(2), None, Some(0)]);
    assert_eq!(caches.resident(), 4);
    let resident = |layer| caches.sphere(id(layer)).map_or(0, SphereCache::resident);
    assert_eq!([0, 1, 2].map(resident), [3, 0, 1]);
}

#[test]
fn what_nobody_wants_and_no_frame_has_shown_for_long_gives_its_slot_back() {
    let mut caches = Caches::new(10, 1);
    let tiles: Vec<TileRequest> = (0..4).map(|x| request(tile(2, x, 0))).collect();
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    updates_until_converged(&mut caches);
    caches.frame_shown(SPHERE.cell);
    // Two are looked at no more; the others are, in frames that follow.
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles[..2]);
    assert_eq!(caches.release_unseen(1), 0, "they were seen in that frame");
    let since = caches.mark_seen();
    assert_eq!(caches.release_unseen(since), 2, "in none since");
    assert_eq!(caches.resident(), 2);
    assert!(!caches.has_work(at_origin), "what is wanted stays");
    // Whoever looks back has it marched again.
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    assert_eq!(updates_until_converged(&mut caches), 2);
}

#[test]
fn tiles_that_are_gathered_follow_each_other_and_only_those_beyond_move() {
    let mut caches = Caches::new(20, 1);
    let tiles: Vec<TileRequest> = (0..12).map(|x| request(tile(4, x, 0))).collect();
    caches.sphere_mut(SPHERE).set_wanted(&[], &tiles);
    updates_until_converged(&mut caches);
    let slots = |caches: &Caches| -> Vec<Slot> {
        let settled = caches.sphere(SPHERE).expect("a sphere");
        let settled = settled.settled(TexelSamples::each(1));
        settled.into_iter().map(|(_, slot)| slot).collect()
    };
    // Every third stays.
    let kept: Vec<TileRequest> = tiles.iter().skip(2).step_by(3).copied().collect();
    caches.sphere_mut(SPHERE).set_wanted(&[], &kept);
    let since = caches.mark_seen();
    assert_eq!(caches.release_unseen(since), 8);
    let before = slots(&caches);
    assert!(caches.slots_needed() > 4, "{before:?}");
    let first = caches.gather(1);
    let moved = [first, caches.gather(20)].concat();
    assert_eq!(caches.gather(20), []);
    let mut expected = before.clone();
    for slot in &mut expected {
        if let Some((_, to)) = moved.iter().find(|(from, _)| from == slot) {
            *slot = *to;
        }
    }
    assert_eq!(slots(&caches), expected);
    assert!(moved.iter().all(|(from, to)| from.0 >= 4 && to.0 < 4));
    assert_eq!((caches.slots_needed(), caches.resident()), (4, 4));
}
