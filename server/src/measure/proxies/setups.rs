//! What is compared.

use crate::march::{BandEnds, ProxySetup};

/// A setup with what it is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kept {
    /// As people read it.
    pub(super) name: &'static str,
    /// Which.
    pub(super) setup: ProxySetup,
    /// Slabs of each layer.
    pub(super) slabs: u32,
    /// Bands of distance of nested domes.
    pub(super) bands: u32,
    /// Where those end.
    pub(super) ends: BandEnds,
    /// How far the reference goes before its domes follow, m: the viewer comes from elsewhere, and what it is shown is resampled.
    pub(super) followed_m: Option<f64>,
    /// Whether plots have it: as many as there are colours.
    pub(super) is_plotted: bool,
}

const PLAIN: Kept = Kept {
    name: "in-layer",
    setup: ProxySetup::InLayer,
    slabs: 1,
    bands: 3,
    ends: BandEnds::Cut,
    followed_m: None,
    is_plotted: true,
};
const NESTED: Kept = Kept {
    name: "nested domes, 3 bands",
    setup: ProxySetup::NestedDomes,
    ..PLAIN
};
const FOLLOWING: Kept = Kept {
    name: "following dome, every 100 m",
    setup: ProxySetup::FollowingDome,
    followed_m: Some(100.0),
    ..PLAIN
};

/// Everything that is compared; what others are held against first.
pub(super) const SETUPS: [Kept; 9] = [
    PLAIN,
    Kept {
        name: "in-layer, 4 slabs",
        slabs: 4,
        ..PLAIN
    },
    Kept {
        name: "static dome",
        setup: ProxySetup::StaticDome,
        ..PLAIN
    },
    FOLLOWING,
    Kept {
        name: "following dome, every 300 m",
        followed_m: Some(300.0),
        is_plotted: false,
        ..FOLLOWING
    },
    Kept {
        name: "nested domes, 2 bands",
        bands: 2,
        is_plotted: false,
        ..NESTED
    },
    NESTED,
    Kept {
        name: "nested domes, 3 bands, gaps",
        ends: BandEnds::Gaps,
        is_plotted: false,
        ..NESTED
    },
    Kept {
        name: "nested domes, 4 bands",
        bands: 4,
        is_plotted: false,
        ..NESTED
    },
];
