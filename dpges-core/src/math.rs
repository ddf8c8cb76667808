//! Three-vectors, matrices and rotations over either element type, and the derivative of a rotation
//! with respect to its raw quaternion.

use pulp::Simd;

use crate::backend::lanes::Lanes;
use crate::backend::number::{Arithmetic, Number};
use crate::backend::real::Real;
use crate::camera::{Camera, Lens};

pub type V3<T> = [T; 3];
/// Row-major.
pub type M3<T> = [[T; 3]; 3];

#[inline(always)]
pub fn dot<N: Arithmetic>(a: V3<N>, b: V3<N>) -> N {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
pub fn cross<N: Arithmetic>(a: V3<N>, b: V3<N>) -> V3<N> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub fn add<N: Arithmetic>(a: V3<N>, b: V3<N>) -> V3<N> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub fn sub<N: Arithmetic>(a: V3<N>, b: V3<N>) -> V3<N> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub fn scale<N: Arithmetic>(a: V3<N>, s: N) -> V3<N> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Element by element.
#[inline(always)]
pub fn times<N: Arithmetic>(a: V3<N>, b: V3<N>) -> V3<N> {
    [a[0] * b[0], a[1] * b[1], a[2] * b[2]]
}

#[inline(always)]
pub fn column<N: Arithmetic>(m: &M3<N>, j: usize) -> V3<N> {
    [m[0][j], m[1][j], m[2][j]]
}

/// m · v
#[inline(always)]
pub fn apply<N: Arithmetic>(m: &M3<N>, v: V3<N>) -> V3<N> {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

/// mᵀ · v
#[inline(always)]
pub fn apply_transposed<N: Arithmetic>(m: &M3<N>, v: V3<N>) -> V3<N> {
    [dot(column(m, 0), v), dot(column(m, 1), v), dot(column(m, 2), v)]
}

#[inline(always)]
pub fn row<T: Real, const W: usize>(values: &[T], index: usize) -> [T; W] {
    values[index * W..(index + 1) * W].try_into().expect("a row has W values")
}

/// Up to this length a quaternion counts as zero and means the identity.
const ZERO_QUATERNION: f64 = 1e-12;

/// Rotation of an unnormalised quaternion (w, x, y, z); the identity for a zero quaternion.
#[inline(always)]
pub fn rotation<N: Number>(q: [N; 4]) -> M3<N> {
    let [w, x, y, z] = unit(q).0;
    let (one, two) = (w.constant(1.0), w.constant(2.0));
    [
        [one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)],
        [two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)],
    ]
}

/// Unit quaternion and reciprocal length (0 for a zero quaternion).
#[inline(always)]
fn unit<N: Number>([w, x, y, z]: [N; 4]) -> ([N; 4], N) {
    let (zero, one) = (w.constant(0.0), w.constant(1.0));
    // scaled first: squares of components near the ends of the range of N would over- or underflow
    let largest = w.abs().max(x.abs()).max(y.abs()).max(z.abs()).max(w.constant(1e-37));
    let (w, x, y, z) = (w / largest, x / largest, y / largest, z / largest);
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let inverse = one / length;
    let none = w.constant(ZERO_QUATERNION).at_least(largest * length);
    let or = {
        #[inline(always)]
        |value: N, default: N| N::select(none, default, value)
    };
    let unit = [or(w * inverse, one), or(x * inverse, zero), or(y * inverse, zero), or(z * inverse, zero)];
    (unit, or(inverse / largest, zero))
}

/// Gradient with respect to the raw quaternion from the gradient with respect to its rotation.
#[inline(always)]
pub fn rotation_backward<T: Real>(q: [T; 4], grad: &M3<T>) -> [T; 4] {
    let (unit, inverse_length) = unit(q);
    let [w, x, y, z] = unit;
    let d = grad;
    let two = T::of(2.0);
    let g = [
        two * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1])),
        two * (w * (d[2][1] - d[1][2]) - two * x * (d[1][1] + d[2][2])
            + y * (d[1][0] + d[0][1])
            + z * (d[0][2] + d[2][0])),
        two * (w * (d[0][2] - d[2][0]) + x * (d[1][0] + d[0][1]) - two * y * (d[0][0] + d[2][2])
            + z * (d[2][1] + d[1][2])),
        two * (w * (d[1][0] - d[0][1]) + x * (d[0][2] + d[2][0]) + y * (d[2][1] + d[1][2])
            - two * z * (d[0][0] + d[1][1])),
    ];
    let along = g[0] * w + g[1] * x + g[2] * y + g[3] * z;
    std::array::from_fn(|i| (g[i] - unit[i] * along) * inverse_length)
}

/// Gradient with respect to the raw quaternion from the gradient with respect to a turn about each axis of the frame that
/// the quaternion rotates, in radians.
#[inline(always)]
pub fn turn_backward<N: Number>(q: [N; 4], [a, b, c]: V3<N>) -> [N; 4] {
    let ([w, x, y, z], inverse_length) = unit(q);
    // a turn by ω moves the unit quaternion by ½ q ω, in three directions at right angles to it and to each other
    let twice = inverse_length.constant(2.0) * inverse_length;
    [
        (-x * a - y * b - z * c) * twice,
        (w * a + y * c - z * b) * twice,
        (w * b + z * a - x * c) * twice,
        (w * c + x * b - y * a) * twice,
    ]
}

/// A camera's numbers in the element type of a kernel.
#[derive(Clone, Copy, Debug)]
pub struct CameraOf<T> {
    pub rotation: M3<T>,
    /// Cross products of the other two rows of the rotation, in cyclic order: of a rotation, its rows.
    pub cofactors: M3<T>,
    pub translation: V3<T>,
    pub fx: T,
    pub fy: T,
    pub cx: T,
    pub cy: T,
    pub near: T,
    pub width: usize,
    pub height: usize,
    /// In f64, whatever T: nothing of it is done for every pixel.
    pub lens: Option<Lens>,
    /// [`Camera::coverage`]
    pub coverage: f64,
}

impl<T: Real> CameraOf<T> {
    pub fn new(camera: &Camera) -> Self {
        let pose = &camera.camera_from_world;
        let rows = pose.rotation.transpose().to_cols_array_2d();
        Self {
            rotation: rows.map(|r| r.map(T::of)),
            cofactors: [0, 1, 2].map(|i| cross(rows[(i + 1) % 3], rows[(i + 2) % 3]).map(T::of)),
            translation: pose.translation.to_array().map(T::of),
            fx: T::of(camera.fx),
            fy: T::of(camera.fy),
            cx: T::of(camera.cx),
            cy: T::of(camera.cy),
            near: T::of(camera.near),
            width: camera.width,
            height: camera.height,
            lens: camera.lens,
            coverage: camera.coverage(),
        }
    }

    /// The same in every lane.
    #[inline(always)]
    pub fn in_lanes<S: Simd>(&self, simd: S) -> CameraOf<Lanes<T, S>> {
        let all = |value: T| Lanes::splat(simd, value);
        let three = |values: V3<T>| Lanes::splat_three(simd, values);
        let rows = |rows: &M3<T>| [three(rows[0]), three(rows[1]), three(rows[2])];
        CameraOf {
            rotation: rows(&self.rotation),
            cofactors: rows(&self.cofactors),
            translation: three(self.translation),
            fx: all(self.fx),
            fy: all(self.fy),
            cx: all(self.cx),
            cy: all(self.cy),
            near: all(self.near),
            width: self.width,
            height: self.height,
            lens: self.lens,
            coverage: self.coverage,
        }
    }

    /// Gradient of the depth of a world point with respect to it, in world axes.
    pub fn depth_slope(&self, world: V3<T>) -> V3<T> {
        match &self.lens {
            Some(lens) if lens.is_wide() => {
                let point = self.transform(world);
                apply_transposed(&self.rotation, scale(point, T::one() / self.depth(point)))
            }
            _ => self.rotation[2],
        }
    }

    /// Axes of a primitive, the columns of `world`, in camera axes, as columns.
    #[inline(always)]
    pub fn axes(&self, world: &M3<T>) -> M3<T> {
        self.rotation.map(|row| std::array::from_fn(|j| dot(row, column(world, j))))
    }
}

impl<N: Number> CameraOf<N> {
    /// Depth of a point in camera axes.
    #[inline(always)]
    pub fn depth(&self, point: V3<N>) -> N {
        match &self.lens {
            None => point[2],
            Some(lens) => N::each(point, |point| [lens.depth(point)])[0],
        }
    }

    /// World point in camera axes.
    #[inline(always)]
    pub fn transform(&self, world: V3<N>) -> V3<N> {
        add(apply(&self.rotation, world), self.translation)
    }
}
