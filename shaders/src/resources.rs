//! Which bound resources a composed module touches.

use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::collections::BTreeSet;

/// Names of the buffers, textures and samplers that the entry point reaches.
///
/// # Errors
/// When the module does not validate; says why.
pub fn resources_of(module: &naga::Module) -> Result<BTreeSet<String>, String> {
    let info = Validator::new(ValidationFlags::empty(), Capabilities::all())
        .validate(module)
        .map_err(|error| error.to_string())?;
    let reached = (0..module.entry_points.len()).flat_map(|index| {
        let entry = info.get_entry_point(index);
        module
            .global_variables
            .iter()
            .filter(move |(handle, _)| !entry[*handle].is_empty())
    });
    Ok(reached
        .filter(|(_, variable)| variable.binding.is_some())
        .filter_map(|(_, variable)| {
            let name = variable.name.as_deref()?;
            // Without the decoration of imported items.
            Some(name.split("X_naga_oil").next().unwrap_or(name).to_owned())
        })
        .collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Features, Kernel, compose};

    #[test]
    fn a_composite_without_layers_reads_no_atlas_and_one_with_layers_does() {
        let of = |layers| {
            let features = Features {
                layers,
                ..Features::default()
            };
            resources_of(&compose(Kernel::Composite, features).expect("composes"))
                .expect("validates")
        };
        assert!(of(1).contains("atlas_radiance"), "{:?}", of(1));
        for name in ["atlas_radiance", "atlas_distance", "page_table"] {
            assert!(!of(0).contains(name), "{:?}", of(0));
        }
    }
}
