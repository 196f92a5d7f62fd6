//! Maps of a weather layer that come from files instead of from its seed.

use std::fmt;
use std::str::FromStr;

use serde_json::Value;

use super::ranges;
use crate::ValueError;
use crate::read_json::document;

/// What [`checked_file_name`] takes, as the schema tells it.
pub(super) const FILE_NAME_PATTERN: &str = "^[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}$";
const _: () = assert!(ranges::GRID_FILE_MAX_CHARS == 64);

/// Which map of a weather layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MapKind {
    /// Where clouds are; the top of the picture is north, its right side east.
    Coverage,
    /// How tall they are, 0 flat to 1 tall; lies as the coverage does.
    Type,
    /// How much of its coverage a cloud keeps at a height: types from left (0) to right (1), the layer's base at the bottom.
    Profile,
}

impl MapKind {
    /// Every kind.
    pub const ALL: [Self; 3] = [Self::Coverage, Self::Type, Self::Profile];

    /// Its name in documents and paths.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Coverage => "coverage",
            Self::Type => "type",
            Self::Profile => "profile",
        }
    }
}

impl fmt::Display for MapKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for MapKind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.name() == text)
            .ok_or_else(|| format!("{text:?} is no map; allowed: coverage, type, profile"))
    }
}

document! {
    /// Files of maps, each a name without folders: beside the scene file, or in the folder `maps` of the server's state.
    /// PNG with 8 or 16 bits of grey, or EXR with one channel, values 0 to 1, sides of 1 to 8192; null for the map that is
    /// made from the seed.
    pub struct MapsDocument {
        /// Where clouds are: 0 nowhere, 1 first of all. The top is north; it repeats after the layer's map span.
        #[schemars(pattern(FILE_NAME_PATTERN))]
        "coverage" => coverage: Option<String> = None,
        /// Factor of the layer's type: 0 flat to 1 tall.
        #[schemars(pattern(FILE_NAME_PATTERN))]
        "type" => cloud_type: Option<String> = None,
        /// How much of its coverage a cloud keeps: types from left to right, heights from the bottom to the top.
        #[schemars(pattern(FILE_NAME_PATTERN))]
        "profile" => profile: Option<String> = None,
        /// Sky time in which other maps, or those of another seed, take the place of these, linearly.
        "transition_s" => transition_s: f64 = 0.0; ranges::TRANSITION_S,
    }
}

/// Maps of a weather layer that come from files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapFiles {
    files: [Option<String>; 3],
    transition_s: f64,
}

impl MapFiles {
    /// Name of a map's file, without folders; none for the map that is made from the seed.
    pub fn file(&self, kind: MapKind) -> Option<&str> {
        self.files[kind as usize].as_deref()
    }

    /// Sky time in which other maps take the place of these.
    pub fn transition_s(&self) -> f64 {
        self.transition_s
    }

    /// Whether all maps are the same files; how long a change takes is not compared.
    pub fn same_files(&self, other: &Self) -> bool {
        self.files == other.files
    }
}

/// A file's name without folders, as grids and maps have it.
pub(super) fn checked_file_name(pointer: &str, name: String) -> Result<String, ValueError> {
    let is_name = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let length = name.chars().count();
    if length == 0
        || length > ranges::GRID_FILE_MAX_CHARS
        || name.starts_with('.')
        || !name.chars().all(is_name)
    {
        return Err(ValueError::new(
            pointer,
            &Value::from(name),
            format!(
                "a file name of 1 to {} letters, digits, \".\", \"_\" and \"-\", not beginning with \".\"",
                ranges::GRID_FILE_MAX_CHARS
            ),
        ));
    }
    Ok(name)
}

impl TryFrom<MapsDocument> for MapFiles {
    type Error = ValueError;

    fn try_from(document: MapsDocument) -> Result<Self, ValueError> {
        let checked = |kind: MapKind, name: Option<String>| {
            name.map(|name| checked_file_name(&format!("/{kind}"), name))
                .transpose()
        };
        Ok(Self {
            files: [
                checked(MapKind::Coverage, document.coverage)?,
                checked(MapKind::Type, document.cloud_type)?,
                checked(MapKind::Profile, document.profile)?,
            ],
            transition_s: ranges::TRANSITION_S.check("/transition_s", document.transition_s)?,
        })
    }
}

impl From<&MapFiles> for MapsDocument {
    fn from(maps: &MapFiles) -> Self {
        let file = |kind| maps.file(kind).map(str::to_owned);
        Self {
            coverage: file(MapKind::Coverage),
            cloud_type: file(MapKind::Type),
            profile: file(MapKind::Profile),
            transition_s: maps.transition_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_a_file_name_without_folders() {
        let maps = |name: &str| {
            MapFiles::try_from(MapsDocument {
                cloud_type: Some(name.to_owned()),
                ..MapsDocument::default()
            })
        };
        assert_eq!(
            maps("towers.png").expect("a name").file(MapKind::Type),
            Some("towers.png")
        );
        for bad in ["", "../x.png", "/etc/passwd", ".hidden", "a b"] {
            assert_eq!(maps(bad).expect_err(bad).pointer, "/type");
        }
    }
}
