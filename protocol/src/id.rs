//! Names for things that cross the wire, as numbers of their own types.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

macro_rules! number_newtype {
    ($(#[$meta:meta])* $name:ident($inner:ty)) => {
        $(#[$meta])*
        #[derive(
            Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
            JsonSchema,
        )]
        #[serde(transparent)]
        pub struct $name(pub $inner);

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

number_newtype! {
    /// One connected client. Never given twice by one run of a server.
    ViewerId(u32)
}
number_newtype! {
    /// A view cell: the viewers near each other that share caches.
    CellId(u32)
}
number_newtype! {
    /// The number of a frame within its viewer's stream, from 1 upwards. 0 means none yet.
    FrameSequence(u32)
}
number_newtype! {
    /// The client's number of a camera input. 0 means the camera of the hello.
    InputSequence(u64)
}
