//! What can be wrong with the input.

/// Why a world cannot be built or a ray cannot be traced.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ReferenceError {
    /// Texels or voxels do not fill the size that is given with them.
    #[error("{what} has {given} values; {expected} are needed")]
    WrongLength {
        /// Which data.
        what: String,
        /// How many values were given.
        given: usize,
        /// How many the sizes ask for.
        expected: usize,
    },
    /// A texture without texels, or with more than an index can count.
    #[error("{what} must have between 1 and 65536 texels along every edge")]
    WrongSize {
        /// Which data.
        what: String,
    },
    /// A layer of the scene lacks the data that its density model reads.
    #[error("layer {layer} needs {what}")]
    Missing {
        /// Index of the layer in the scene.
        layer: usize,
        /// What it needs.
        what: &'static str,
    },
    /// A voxel that is not a finite number of at least 0.
    #[error("voxel {index} of layer {layer} is {value}; allowed: finite and at least 0")]
    BadVoxel {
        /// Index of the layer in the scene.
        layer: usize,
        /// Index of the voxel.
        index: usize,
        /// What it holds.
        value: f32,
    },
    /// A number that is not finite or not in the range that it must be in.
    #[error("{what} is {value}; allowed: {allowed}")]
    BadNumber {
        /// Which number.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What may stand there.
        allowed: &'static str,
    },
}

/// The number, if it is finite and within both ends.
pub(crate) fn checked(
    what: &'static str,
    value: f64,
    range: std::ops::RangeInclusive<f64>,
    allowed: &'static str,
) -> Result<f64, ReferenceError> {
    if value.is_finite() && range.contains(&value) {
        Ok(value)
    } else {
        Err(ReferenceError::BadNumber {
            what,
            value,
            allowed,
        })
    }
}
