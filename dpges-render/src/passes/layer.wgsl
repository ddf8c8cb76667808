// Marks in the second word of a layer, beside the index of the surfel.

// Nothing is behind this fragment.
const OPAQUE: u32 = 0x80000000u;
// There is no fragment, and nothing is behind.
const NOTHING: u32 = 0xffffffffu;

// Stand for depths that nothing reaches: finite, as shaders may take it that numbers are.
const FARTHEST: f32 = 1e15;
// Length of a ramp at which it is a step: shorter ones have slopes beyond the range of numbers.
const SHORTEST_RAMP: f32 = 1e-20;
const LARGEST_HALF: f32 = 65504.0;
