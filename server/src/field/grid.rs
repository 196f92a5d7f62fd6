//! Voxels from files: raw 32-bit floats, little-endian, x fastest, then altitude, then z.

use skycell_protocol::scene::{DensityModel, GridDensity};
use skycell_protocol::{Scene, SceneError};
use std::path::Path;

/// Density of voxels, 0…1, x fastest.
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelGrid {
    /// Voxels along x, altitude and z.
    pub dimensions: [u32; 3],
    /// As many values as voxels.
    pub values: Vec<f32>,
}

/// Why a file holds no voxels of a grid; the text names file, place, value and what is allowed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GridError {
    /// The file is not there or cannot be read.
    #[error("{file} cannot be read in the folder of grids: {error}")]
    Unreadable {
        /// Its name.
        file: String,
        /// What went wrong.
        error: std::io::Error,
    },
    /// It has another length than its dimensions say.
    #[error("{file} has {bytes} bytes; {dimensions:?} voxels of 4 bytes are {expected}")]
    WrongLength {
        /// Its name.
        file: String,
        /// Its length.
        bytes: u64,
        /// What the document says.
        dimensions: [u32; 3],
        /// The length that it should have.
        expected: u64,
    },
    /// A value is no density.
    #[error("{file} has the value {value} at voxel {index}; allowed is 0 to 1")]
    WrongValue {
        /// Its name.
        file: String,
        /// Counted from 0.
        index: usize,
        /// What stands there.
        value: f32,
    },
}

/// Reads the voxels of a grid from a folder.
///
/// # Errors
/// When the file is missing, of another length, or holds what is no density.
pub fn load_grid(folder: &Path, grid: &GridDensity) -> Result<VoxelGrid, GridError> {
    let file = || grid.file().to_owned();
    let unreadable = |error| GridError::Unreadable {
        file: file(),
        error,
    };
    let path = folder.join(grid.file());
    let bytes = std::fs::metadata(&path).map_err(unreadable)?.len();
    let expected = 4 * grid.voxels();
    if bytes != expected {
        return Err(GridError::WrongLength {
            file: file(),
            bytes,
            dimensions: grid.dimensions(),
            expected,
        });
    }
    let raw = std::fs::read(&path).map_err(unreadable)?;
    let values: Vec<f32> = raw
        .chunks_exact(4)
        .map(|four| f32::from_le_bytes([four[0], four[1], four[2], four[3]]))
        .collect();
    if let Some((index, value)) = (0..)
        .zip(&values)
        .find(|(_, value)| !(0.0..=1.0).contains(*value))
    {
        return Err(GridError::WrongValue {
            file: file(),
            index,
            value: *value,
        });
    }
    Ok(VoxelGrid {
        dimensions: grid.dimensions(),
        values,
    })
}

/// Whether all grids of a scene can be read from a folder.
///
/// # Errors
/// Names the layer's file and what is wrong with it.
pub fn check_grids(scene: &Scene, folder: &Path) -> Result<(), SceneError> {
    for (index, layer) in scene.layers().iter().enumerate() {
        if let DensityModel::Grid(grid) = layer.density() {
            load_grid(folder, grid).map_err(|error| {
                SceneError::new(
                    format!("/layers/{index}/density/file"),
                    &serde_json::Value::from(grid.file()),
                    format!("a file of voxels: {error}"),
                )
            })?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn scene() -> Scene {
        let document = json!({"version": 1, "layers": [{"density":
            {"model": "grid", "file": "two.f32", "dimensions": [2, 1, 1]}}]});
        Scene::from_json(&document).expect("valid")
    }

    fn write(folder: &Path, values: &[f32]) {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(folder.join("two.f32"), bytes).expect("writable");
    }

    #[test]
    fn a_file_that_is_no_grid_is_refused_with_what_is_wrong() {
        let folder = tempfile::tempdir().expect("a folder");
        let told = |values: Option<&[f32]>| {
            if let Some(values) = values {
                write(folder.path(), values);
            }
            let error = check_grids(&scene(), folder.path()).expect_err("refused");
            assert_eq!(error.pointer, "/layers/0/density/file");
            error.allowed
        };
        assert!(told(None).contains("cannot be read"));
        assert!(told(Some(&[0.5])).contains("4 bytes; [2, 1, 1] voxels of 4 bytes are 8"));
        assert!(told(Some(&[0.5, f32::NAN])).contains("NaN at voxel 1"));
        assert!(told(Some(&[-0.5, 0.0])).contains("-0.5 at voxel 0"));
        assert!(told(Some(&[0.5, f32::INFINITY])).contains("inf at voxel 1"));
        write(folder.path(), &[0.0, 1.0]);
        assert_eq!(check_grids(&scene(), folder.path()), Ok(()));
    }
}
