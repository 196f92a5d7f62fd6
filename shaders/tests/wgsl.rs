//! The WGSL as a whole: every kernel composes and validates, and every shared struct has one layout.

use naga::valid::{ValidationFlags, Validator};
use skycell_shaders::layout::{self, GpuLayout};
use skycell_shaders::{CAPABILITIES, Features, Kernel, compose};

#[test]
fn every_entry_point_validates_in_every_specialisation() {
    for kernel in Kernel::ALL {
        for features in Features::all() {
            let module = compose(kernel, features).unwrap_or_else(|error| panic!("{error}"));
            Validator::new(ValidationFlags::all(), CAPABILITIES)
                .validate(&module)
                .unwrap_or_else(|error| panic!("{kernel:?} {features:?}: {error:?}"));
            let names: Vec<&str> = module
                .entry_points
                .iter()
                .map(|e| e.name.as_str())
                .collect();
            assert_eq!(names, [kernel.entry_point()]);
        }
    }
}

#[test]
fn every_view_validates_with_every_density_and_number_of_layers() {
    use skycell_shaders::{Density, Shown};
    for shown in Shown::all().filter(|shown| *shown != Shown::Picture) {
        for (layers, density) in [
            (0, Density::Homogeneous),
            (1, Density::Weather),
            (2, Density::Grid),
            (4, Density::Homogeneous),
        ] {
            for screen_space in [false, true] {
                let kernel = if shown.is_inspection() {
                    Kernel::Inspect
                } else {
                    Kernel::Composite
                };
                if shown.is_of_cache() && screen_space {
                    continue;
                }
                let features = Features {
                    layers,
                    density,
                    screen_space,
                    shown,
                    ray_list: shown == Shown::Steps,
                    shared_background: layers == 2,
                    ..Features::default()
                };
                let module = compose(kernel, features).unwrap_or_else(|error| panic!("{error}"));
                Validator::new(ValidationFlags::all(), CAPABILITIES)
                    .validate(&module)
                    .unwrap_or_else(|error| panic!("{kernel:?} {features:?}: {error:?}"));
            }
        }
    }
}

#[test]
fn clouds_alone_validate_over_every_sky_and_have_no_background() {
    use skycell_shaders::CloudsAlone;
    let background = [
        "background_radiance",
        "sun_disc_radiance",
        "moon_disc_radiance",
        "star_radiance",
    ];
    for (layers, index) in (0..=4).zip(0..) {
        for clouds_alone in [CloudsAlone::InHaze, CloudsAlone::WithoutHaze] {
            for bits in 0..8 {
                let features = Features {
                    layers,
                    clouds_alone,
                    screen_space: bits & 1 != 0,
                    physical_sky: bits & 2 != 0,
                    shared_background: bits & 4 != 0,
                    light_shafts: bits == 6,
                    own_phases: index % 2 == 0,
                    overlap: index % 2 == 1,
                    ..Features::default()
                };
                let module = compose(Kernel::Composite, features).unwrap_or_else(|e| panic!("{e}"));
                Validator::new(ValidationFlags::all(), CAPABILITIES)
                    .validate(&module)
                    .unwrap_or_else(|error| panic!("{features:?}: {error:?}"));
            }
            let called = functions_called(
                Kernel::Composite,
                Features {
                    layers,
                    clouds_alone,
                    ..Features::default()
                },
            );
            for name in background {
                assert!(
                    !called.contains(name),
                    "{layers} {clouds_alone:?}: {called:?}"
                );
            }
        }
    }
    let picture = functions_called(Kernel::Composite, Features::default());
    assert!(picture.contains("sun_disc_radiance"), "{picture:?}");
}

/// Name without the decoration that linking adds to imported items.
fn plain_name(decorated: &str) -> &str {
    decorated.split("X_naga_oil").next().unwrap_or(decorated)
}

fn wgsl_layout(module: &naga::Module, name: &str) -> Option<(Vec<(String, usize)>, usize)> {
    module.types.iter().find_map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span }
            if ty.name.as_deref().map(plain_name) == Some(name) =>
        {
            let fields = members
                .iter()
                .map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize))
                .collect();
            Some((fields, *span as usize))
        }
        _ => None,
    })
}

fn check<T: GpuLayout>(kernel: Kernel) {
    let features = Features {
        sun_layers: 1,
        ..Features::default()
    };
    let module = compose(kernel, features).expect("composes");
    let (fields, size) =
        wgsl_layout(&module, T::NAME).unwrap_or_else(|| panic!("{} is not in {kernel:?}", T::NAME));
    let ours: Vec<(String, usize)> = T::fields()
        .into_iter()
        .map(|(name, offset)| (name.to_owned(), offset))
        .collect();
    assert_eq!(ours, fields, "fields of {}", T::NAME);
    assert_eq!(size_of::<T>(), size, "size of {}", T::NAME);
}

#[test]
fn shared_structs_have_the_names_offsets_and_sizes_of_the_wgsl() {
    check::<layout::Inspection>(Kernel::Inspect);
    check::<layout::Planet>(Kernel::MarchTexels);
    check::<layout::Sun>(Kernel::MarchTexels);
    check::<layout::Sky>(Kernel::MarchTexels);
    check::<layout::Light>(Kernel::MarchTexels);
    check::<layout::Diffusion>(Kernel::MarchTexels);
    check::<layout::Layer>(Kernel::MarchTexels);
    check::<layout::Part>(Kernel::MarchTexels);
    check::<layout::Proxy>(Kernel::MarchTexels);
    check::<layout::Night>(Kernel::MarchTexels);
    check::<layout::Scene>(Kernel::MarchTexels);
    check::<layout::TileWork>(Kernel::MarchTexels);
    check::<layout::AuditWork>(Kernel::AuditTexels);
    check::<layout::AuditSample>(Kernel::AuditTexels);
    check::<layout::SunLevel>(Kernel::MarchTexels);
    check::<layout::SunLayer>(Kernel::MarchTexels);
    check::<layout::SunVolume>(Kernel::MarchTexels);
    check::<layout::SunColumns>(Kernel::SunColumns);
    check::<layout::Reference>(Kernel::AuditTexels);
    check::<layout::PageTable>(Kernel::Composite);
    check::<layout::View>(Kernel::Composite);
    check::<layout::Fade>(Kernel::FadePictures);
    check::<layout::ResampleWork>(Kernel::ResampleTiles);
    check::<layout::Resample>(Kernel::ResampleTiles);
    check::<layout::Air>(Kernel::MakeAirView);
    check::<layout::ShaftFrame>(Kernel::CloudShadows);
    check::<layout::ShadowWork>(Kernel::CloudShadows);
    check::<layout::ShaftWork>(Kernel::MakeLightShafts);
    check::<layout::ListedRay>(Kernel::MarchPixels);
    check::<layout::WindowSlice>(Kernel::ResolveWindow);
    check::<layout::Window>(Kernel::ResolveWindow);
}

/// Names of the functions that a kernel's entry point reaches.
fn functions_called(kernel: Kernel, features: Features) -> std::collections::BTreeSet<String> {
    let module = compose(kernel, features).expect("composes");
    let mut called = std::collections::BTreeSet::new();
    let mut waiting: Vec<&naga::Function> =
        module.entry_points.iter().map(|e| &e.function).collect();
    while let Some(function) = waiting.pop() {
        let mut blocks = vec![&function.body];
        while let Some(block) = blocks.pop() {
            for statement in block {
                use naga::Statement::{Block, Call, If, Loop, Switch};
                match statement {
                    Call { function, .. } => {
                        let function = &module.functions[*function];
                        let name = function.name.as_deref().unwrap_or_default();
                        if called.insert(plain_name(name).to_owned()) {
                            waiting.push(function);
                        }
                    }
                    Block(inner) => blocks.push(inner),
                    If { accept, reject, .. } => blocks.extend([accept, reject]),
                    Loop {
                        body, continuing, ..
                    } => blocks.extend([body, continuing]),
                    Switch { cases, .. } => blocks.extend(cases.iter().map(|case| &case.body)),
                    _ => {}
                }
            }
        }
    }
    called
}

/// Names of a kernel's functions.
fn functions(kernel: Kernel, features: Features) -> Vec<String> {
    let module = compose(kernel, features).expect("composes");
    let names = module.functions.iter().filter_map(|(_, function)| {
        let name = function.name.as_deref()?;
        Some(plain_name(name).to_owned())
    });
    names.collect()
}

#[test]
fn nothing_of_domes_is_compiled_in_where_texels_lie_on_shells() {
    let kernels = [
        Kernel::MarchTexels,
        Kernel::AuditTexels,
        Kernel::Composite,
        Kernel::ResampleTiles,
    ];
    let has = |features, word: &str| {
        kernels.map(|kernel| {
            functions(kernel, features)
                .iter()
                .any(|name| name.contains(word))
        })
    };
    for parallax in [false, true] {
        let shells = Features {
            parallax,
            ..Features::default()
        };
        let domes = Features {
            domes: true,
            bands: true,
            ..shells
        };
        assert_eq!(has(shells, "dome"), [false; 4]);
        assert_eq!(has(shells, "band"), [false; 4]);
        assert_eq!(has(domes, "dome"), [true; 4]);
        assert_eq!(has(domes, "band"), [true, true, false, false]);
        let bandless = Features {
            bands: false,
            ..domes
        };
        assert_eq!(has(bandless, "band"), [false; 4]);
    }
}
