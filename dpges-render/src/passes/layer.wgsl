// Marks in the second word of a layer, beside the index of the surfel.

// Nothing is behind this fragment.
const OPAQUE: u32 = 0x80000000u;
// There is no fragment, and nothing is behind.
const NOTHING: u32 = 0xffffffffu;
