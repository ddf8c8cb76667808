//! The built-in scene: a room with a box and three balls on a patterned floor, ray traced.
//!
//! World units are metres, z is up, the floor is z = 0. Everything is closed and opaque: every ray from inside the room
//! hits something.

use glam::{DVec2, DVec3};

const ROOM_LOW: DVec3 = DVec3::new(-3.0, -3.0, 0.0);
const ROOM_HIGH: DVec3 = DVec3::new(3.0, 3.0, 3.0);
const BOX_LOW: DVec3 = DVec3::new(-0.9, 0.15, 0.0);
const BOX_HIGH: DVec3 = DVec3::new(-0.2, 0.85, 0.6);
const LIGHT: DVec3 = DVec3::new(1.0, -1.5, 2.8);
const AMBIENT: f64 = 0.4;
const SHININESS: f64 = 24.0;
/// Hits nearer than this belong to the surface that the ray left.
const SELF_HIT: f64 = 1e-7;

/// Centre and radius.
const BALLS: [(DVec3, f64); 3] =
    [(DVec3::new(0.5, 0.45, 0.45), 0.45), (DVec3::new(0.35, -0.6, 0.3), 0.3), (DVec3::new(-0.6, -0.35, 0.22), 0.22)];

#[derive(Clone, Copy, Debug, PartialEq)]
enum Thing {
    Floor,
    Ceiling,
    /// Facing along x (0) or y (1).
    Wall(usize),
    Box,
    Ball(usize),
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    /// In units of the length of the ray's direction.
    pub distance: f64,
    pub position: DVec3,
    /// Unit normal, towards the origin of the ray.
    pub normal: DVec3,
    thing: Thing,
}

/// The nearest surface along a ray from inside the room.
pub(super) fn trace(origin: DVec3, direction: DVec3) -> Hit {
    let mut hit = room(origin, direction);
    let things = [the_box(origin, direction)].into_iter().chain((0..BALLS.len()).map(|i| ball(origin, direction, i)));
    for candidate in things.flatten() {
        if candidate.distance < hit.distance {
            hit = candidate;
        }
    }
    hit
}

impl Hit {
    fn new(origin: DVec3, direction: DVec3, distance: f64, normal: DVec3, thing: Thing) -> Self {
        Self { distance, position: origin + distance * direction, normal, thing }
    }

    /// Display-referred colour without highlights, the same from all directions.
    pub fn diffuse(&self) -> DVec3 {
        let lambert = self.normal.dot((LIGHT - self.position).normalize()).max(0.0);
        (self.albedo() * (AMBIENT + (1.0 - AMBIENT) * lambert)).clamp(DVec3::ZERO, DVec3::ONE)
    }

    /// Display-referred colour seen from `eye`: diffuse and a mild Blinn–Phong highlight.
    pub fn colour(&self, eye: DVec3) -> DVec3 {
        let gloss = match self.thing {
            Thing::Ball(_) => 0.25,
            Thing::Floor | Thing::Box => 0.08,
            Thing::Wall(_) | Thing::Ceiling => 0.0,
        };
        let half = ((LIGHT - self.position).normalize() + (eye - self.position).normalize()).normalize();
        let highlight = gloss * self.normal.dot(half).max(0.0).powf(SHININESS);
        (self.diffuse() + DVec3::splat(highlight)).clamp(DVec3::ZERO, DVec3::ONE)
    }

    fn albedo(&self) -> DVec3 {
        let p = self.position;
        match self.thing {
            Thing::Floor => {
                let tile = if checker(p.x * 2.5, p.y * 2.5, 0.0) {
                    DVec3::new(0.85, 0.8, 0.7)
                } else {
                    DVec3::new(0.35, 0.25, 0.2)
                };
                tile * (0.75 + 0.25 * noise(p * 12.0))
            }
            Thing::Ceiling => DVec3::new(0.8, 0.8, 0.78) * (0.9 + 0.1 * noise(p * 3.0)),
            Thing::Wall(axis) => {
                let along = if axis == 0 { p.y } else { p.x };
                let paint = [DVec3::new(0.75, 0.55, 0.45), DVec3::new(0.45, 0.6, 0.75)][axis];
                paint * (0.7 + 0.15 * (6.0 * along).sin() + 0.15 * noise(p * 5.0))
            }
            Thing::Box => {
                let check = checker(p.x * 8.0 + 0.3, p.y * 8.0 + 0.3, p.z * 8.0 + 0.3);
                if check { DVec3::new(0.9, 0.55, 0.15) } else { DVec3::new(0.35, 0.15, 0.45) }
            }
            Thing::Ball(0) => {
                let stripe = 0.5 + 0.5 * (24.0 * p.z + 6.0 * self.normal.x).sin();
                DVec3::new(0.85, 0.15, 0.1).lerp(DVec3::new(0.95, 0.85, 0.4), stripe)
            }
            Thing::Ball(1) => {
                let marble = 0.5 + 0.5 * (14.0 * p.x + 8.0 * noise(p * 6.0)).sin();
                DVec3::new(0.1, 0.35, 0.8).lerp(DVec3::new(0.85, 0.95, 1.0), marble)
            }
            Thing::Ball(_) => DVec3::new(0.1, 0.35, 0.12).lerp(DVec3::new(0.5, 0.85, 0.3), noise(p * 25.0)),
        }
    }
}

/// Distances at which a ray enters and leaves a box along each axis.
fn slabs(origin: DVec3, direction: DVec3, low: DVec3, high: DVec3) -> (DVec3, DVec3) {
    let (a, b) = ((low - origin) / direction, (high - origin) / direction);
    (a.min(b), a.max(b))
}

fn room(origin: DVec3, direction: DVec3) -> Hit {
    let (_, leave) = slabs(origin, direction, ROOM_LOW, ROOM_HIGH);
    let axis = leave.min_position();
    let normal = -DVec3::AXES[axis] * direction[axis].signum();
    let thing = match (axis, direction.z < 0.0) {
        (2, true) => Thing::Floor,
        (2, false) => Thing::Ceiling,
        _ => Thing::Wall(axis),
    };
    Hit::new(origin, direction, leave[axis], normal, thing)
}

fn the_box(origin: DVec3, direction: DVec3) -> Option<Hit> {
    let (enter, leave) = slabs(origin, direction, BOX_LOW, BOX_HIGH);
    let axis = enter.max_position();
    let distance = enter[axis];
    (distance > SELF_HIT && distance < leave.min_element()).then(|| {
        let normal = -DVec3::AXES[axis] * direction[axis].signum();
        Hit::new(origin, direction, distance, normal, Thing::Box)
    })
}

fn ball(origin: DVec3, direction: DVec3, index: usize) -> Option<Hit> {
    let (centre, radius) = BALLS[index];
    let to_origin = origin - centre;
    let a = direction.length_squared();
    let b = to_origin.dot(direction);
    let discriminant = b * b - a * (to_origin.length_squared() - radius * radius);
    let distance = (-b - discriminant.max(0.0).sqrt()) / a;
    (discriminant > 0.0 && distance > SELF_HIT).then(|| {
        let normal = (origin + distance * direction - centre) / radius;
        Hit::new(origin, direction, distance, normal, Thing::Ball(index))
    })
}

fn checker(x: f64, y: f64, z: f64) -> bool {
    (x.floor() + y.floor() + z.floor()).rem_euclid(2.0) < 1.0
}

/// Smooth noise in 0..1 with features of about one unit.
fn noise(p: DVec3) -> f64 {
    let cell = p.floor();
    let t = p - cell;
    let s = t * t * (DVec3::splat(3.0) - 2.0 * t);
    let corner = |x: f64, y: f64, z: f64| lattice(cell + DVec3::new(x, y, z));
    let edge = |y, z| corner(0.0, y, z) + s.x * (corner(1.0, y, z) - corner(0.0, y, z));
    let face = |z| DVec2::new(edge(0.0, z), edge(1.0, z)).dot(DVec2::new(1.0 - s.y, s.y));
    face(0.0) + s.z * (face(1.0) - face(0.0))
}

/// A value in 0..1 for a lattice point, from an integer hash.
fn lattice(p: DVec3) -> f64 {
    let [x, y, z] = p.to_array().map(|coordinate| coordinate as i64 as u64);
    let mut hash = x.wrapping_mul(0x9e37_79b9_7f4a_7c15)
        ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f)
        ^ z.wrapping_mul(0x1656_67b1_9e37_79f9);
    hash = (hash ^ (hash >> 31)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    hash = (hash ^ (hash >> 29)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (hash >> 40) as f64 / (1u64 << 24) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_meet_the_things_in_front_of_them() {
        let eye = DVec3::new(0.5, -2.5, 0.45);
        let hit = trace(eye, DVec3::Y * 2.0);
        assert_eq!(hit.thing, Thing::Ball(1));
        let hit = trace(DVec3::new(0.5, 2.5, 0.45), -DVec3::Y * 2.0);
        assert_eq!(hit.thing, Thing::Ball(0));
        assert!((hit.distance - 0.8).abs() < 1e-12 && (hit.normal - DVec3::Y).length() < 1e-12);
        let hit = trace(DVec3::new(-0.5, 0.5, 2.0), -DVec3::Z);
        assert_eq!(hit.thing, Thing::Box);
        assert!((hit.distance - 1.4).abs() < 1e-12 && hit.normal == DVec3::Z);
        let hit = trace(eye, -DVec3::Z);
        assert_eq!((hit.thing, hit.normal), (Thing::Floor, DVec3::Z));
        assert!((hit.position.z).abs() < 1e-12);
        let hit = trace(eye, DVec3::new(1.0, 0.0, 0.001));
        assert_eq!((hit.thing, hit.normal), (Thing::Wall(0), -DVec3::X));
    }

    #[test]
    fn noise_is_smooth_bounded_and_varied() {
        let values: Vec<f64> = (0..1000).map(|i| noise(DVec3::new(0.01 * f64::from(i) - 5.0, 0.3, -0.7))).collect();
        assert!(values.iter().all(|v| (0.0..=1.0).contains(v)));
        assert!(values.windows(2).all(|pair| (pair[0] - pair[1]).abs() < 0.03));
        let (low, high) = values.iter().fold((1.0f64, 0.0f64), |(low, high), &v| (low.min(v), high.max(v)));
        assert!(high - low > 0.4);
    }
}
