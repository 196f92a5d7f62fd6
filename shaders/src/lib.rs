//! Skycell shaders.
