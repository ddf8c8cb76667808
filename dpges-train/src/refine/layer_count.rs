//! The number of layers that a scene needs: the fewest that leave hardly any pixel open that more layers would close.

/// Largest share of pixels that may stay open although more layers would close them.
pub const MOST_OPEN: f64 = 0.02;

/// A pixel is open if its layers transmit more light than this: one step of an 8-bit picture.
const OPEN_TRANSMITTANCE: f32 = 1.0 / 255.0;

/// Share of the pixels that are open after K layers, for K from 1 to the number of layers peeled, among those that
/// have a layer at all (T_1 < 1); 0 if none has.
///
/// `transmittance` [(K + 1) × `pixels`]: planes T_0 (1 everywhere) to T_K, as compositing gives them.
///
/// # Panics
/// If `pixels` is 0.
pub fn open_share(transmittance: &[f32], pixels: usize) -> Vec<f64> {
    let planes = transmittance.chunks_exact(pixels).skip(1);
    let Some(first) = planes.clone().next() else { return Vec::new() };
    let covered = first.iter().filter(|&&t| t < 1.0).count().max(1) as f64;
    let open = |plane: &[f32]| {
        let open = first.iter().zip(plane).filter(|&(&first, &t)| first < 1.0 && t > OPEN_TRANSMITTANCE);
        open.count() as f64 / covered
    };
    planes.map(open).collect()
}

/// The fewest layers K ≥ `fewest` after which at most the share `most` of the pixels is open that all layers together close:
/// `open_share[K − 1]`, from [`open_share`] or its mean over views. No layer closes a pixel where rims meet the sky;
/// more layers would only cost time.
pub fn choose(open_share: &[f64], most: f64, fewest: usize) -> usize {
    let never = open_share.last().copied().unwrap_or(0.0);
    let enough = open_share.iter().position(|&share| share - never <= most);
    enough.map_or(open_share.len(), |index| index + 1).max(fewest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_pixels_that_have_a_layer() {
        // five pixels; the last has no layer and does not count
        let planes = [
            [1.0; 5],
            [0.0, 0.5, 0.5, 0.9, 1.0],
            [0.0, 0.0, 0.1, 0.5, 1.0],
            [0.0, 0.0, 1.0 / 255.0, 0.2, 1.0],
            [0.0, 0.0, 0.0, 0.003, 1.0],
        ];
        assert_eq!(open_share(planes.as_flattened(), 5), [0.75, 0.5, 0.25, 0.0]);
    }

    #[test]
    fn pictures_without_layers_are_never_open() {
        assert_eq!(open_share(&[1.0; 9], 3), [0.0, 0.0]);
        assert!(open_share(&[1.0; 3], 3).is_empty());
    }

    #[test]
    fn the_fewest_layers_that_are_enough() {
        let share = [0.6, 0.1, 0.02, 0.001];
        for (most, layers) in [(1.0, 1), (0.6, 1), (0.5, 2), (MOST_OPEN, 3), (0.0189, 4), (0.0, 4)] {
            assert_eq!(choose(&share, most, 1), layers, "{most}");
        }
        // seen of a ray-traced room, where 3 % of the pixels never close
        let room = [0.433, 0.181, 0.083, 0.048, 0.038, 0.033, 0.032, 0.031];
        assert_eq!(choose(&room, MOST_OPEN, 1), 4);
        for fewest in [1, 2] {
            assert_eq!(choose(&[0.5; 8], MOST_OPEN, fewest), fewest);
        }
        assert_eq!(choose(&[], MOST_OPEN, 1), 1);
        assert_eq!(choose(&[f64::NAN, 0.0], MOST_OPEN, 1), 2);
    }
}
