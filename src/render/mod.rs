//! Pictures of a cloth.
