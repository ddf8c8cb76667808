//! Records: numbers that kernels read from and write to buffers together.

use cubecl::prelude::*;

/// A value that takes consecutive numbers of a buffer.
#[cube]
pub trait Record: CubeType + 'static {
    /// How many numbers it takes.
    const LEN: usize;

    /// Reads the numbers from `start` on.
    fn load(numbers: &[f32], start: usize) -> Self;

    /// Writes the numbers from `start` on.
    fn store(value: Self, numbers: &mut [f32], start: usize);
}

#[cube]
impl Record for f32 {
    const LEN: usize = 1;

    fn load(numbers: &[f32], start: usize) -> f32 {
        numbers[start]
    }

    fn store(value: f32, numbers: &mut [f32], start: usize) {
        numbers[start] = value;
    }
}

/// Declares a struct for kernels that is a [`Record`] of its fields, in the order in which they stand.
macro_rules! record {
    (
        $(#[$meta:meta])*
        $visibility:vis struct $name:ident {
            $($(#[$field_meta:meta])* pub $field:ident: $kind:ident,)*
        }
    ) => {
        $(#[$meta])*
        #[derive(CubeType, Clone, Copy)]
        #[expand(derive(Clone, Copy))]
        $visibility struct $name {
            $($(#[$field_meta])* pub $field: $kind,)*
        }

        #[cube]
        impl Record for $name {
            const LEN: usize = 0 $(+ <$kind as Record>::LEN)*;

            fn load(numbers: &[f32], start: usize) -> $name {
                let at = start;
                $(
                    let $field = <$kind as Record>::load(numbers, at);
                    let at = at + comptime!(<$kind as Record>::LEN);
                )*
                let _end = at;
                $name { $($field,)* }
            }

            fn store(value: $name, numbers: &mut [f32], start: usize) {
                let at = start;
                $(
                    <$kind as Record>::store(value.$field, numbers, at);
                    let at = at + comptime!(<$kind as Record>::LEN);
                )*
                let _end = at;
            }
        }
    };
}
pub(crate) use record;
