//! The convolutions of the networks, as torchvision numbers them.

use std::fmt;

/// A network whose features LPIPS compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Network {
    /// AlexNet, in the version of one tower.
    Alex,
    Vgg,
}

/// A convolution, then a ReLU.
#[derive(Debug)]
pub struct Convolution {
    /// Its number in torchvision's `features`.
    pub index: usize,
    /// Channels that go in and come out.
    pub channels: [usize; 2],
    /// Width and height of the kernel, pixels of what goes in.
    pub kernel: usize,
    pub stride: usize,
    /// Zeros around what goes in.
    pub padding: usize,
    /// Width and height of the windows of a max pooling before it, which are 2 px apart.
    pub pool: Option<usize>,
    /// Whether the features after its ReLU are compared.
    pub is_compared: bool,
}

/// A tensor of the file of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorShape {
    pub name: String,
    pub shape: Vec<usize>,
}

const ALEX: [Convolution; 5] = [
    Convolution { index: 0, channels: [3, 64], kernel: 11, stride: 4, padding: 2, pool: None, is_compared: true },
    Convolution { index: 3, channels: [64, 192], kernel: 5, stride: 1, padding: 2, pool: Some(3), is_compared: true },
    Convolution { index: 6, channels: [192, 384], kernel: 3, stride: 1, padding: 1, pool: Some(3), is_compared: true },
    Convolution { index: 8, channels: [384, 256], kernel: 3, stride: 1, padding: 1, pool: None, is_compared: true },
    Convolution { index: 10, channels: [256, 256], kernel: 3, stride: 1, padding: 1, pool: None, is_compared: true },
];

const VGG: [Convolution; 13] = [
    of_vgg(0, [3, 64], false, false),
    of_vgg(2, [64, 64], false, true),
    of_vgg(5, [64, 128], true, false),
    of_vgg(7, [128, 128], false, true),
    of_vgg(10, [128, 256], true, false),
    of_vgg(12, [256, 256], false, false),
    of_vgg(14, [256, 256], false, true),
    of_vgg(17, [256, 512], true, false),
    of_vgg(19, [512, 512], false, false),
    of_vgg(21, [512, 512], false, true),
    of_vgg(24, [512, 512], true, false),
    of_vgg(26, [512, 512], false, false),
    of_vgg(28, [512, 512], false, true),
];

const fn of_vgg(index: usize, channels: [usize; 2], is_pooled: bool, is_compared: bool) -> Convolution {
    let pool = if is_pooled { Some(2) } else { None };
    Convolution { index, channels, kernel: 3, stride: 1, padding: 1, pool, is_compared }
}

impl Network {
    pub const ALL: [Self; 2] = [Self::Alex, Self::Vgg];

    /// As its file calls it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Alex => "alex",
            Self::Vgg => "vgg",
        }
    }

    /// From the finest features to the coarsest.
    pub fn convolutions(self) -> &'static [Convolution] {
        match self {
            Self::Alex => &ALEX,
            Self::Vgg => &VGG,
        }
    }

    /// Everything that its file holds.
    pub fn tensors(self) -> Vec<TensorShape> {
        let of_convolutions = self.convolutions().iter().flat_map(|convolution| {
            let Convolution { channels: [from, to], kernel, .. } = *convolution;
            let weight = TensorShape { name: convolution.weight(), shape: vec![to, from, kernel, kernel] };
            [weight, TensorShape { name: convolution.bias(), shape: vec![to] }]
        });
        let compared = self.convolutions().iter().filter(|convolution| convolution.is_compared);
        let linear = compared.enumerate().map(|(level, convolution)| TensorShape {
            name: linear(level),
            shape: vec![1, convolution.channels[1], 1, 1],
        });
        of_convolutions.chain(linear).collect()
    }

    /// Whether pictures of that size, px, are large enough: 31 px on the shorter side for AlexNet, 16 px for VGG16.
    pub fn fits(self, width: usize, height: usize) -> bool {
        let left_side = self.convolutions().iter().try_fold(width.min(height), |side, convolution| {
            let pooled = convolution.pool.map_or(Some(side), |window| Some(side.checked_sub(window)? / 2 + 1))?;
            let padded = pooled + 2 * convolution.padding;
            Some(padded.checked_sub(convolution.kernel)? / convolution.stride + 1)
        });
        left_side.is_some()
    }
}

impl fmt::Display for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Convolution {
    /// Name of its weights.
    pub fn weight(&self) -> String {
        format!("features.{}.weight", self.index)
    }

    /// Name of its biases.
    pub fn bias(&self) -> String {
        format!("features.{}.bias", self.index)
    }
}

/// Name of the weights of the differences at a level of features, 0 for the finest.
pub fn linear(level: usize) -> String {
    format!("lin{level}.model.1.weight")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_that_come_out_go_in_and_five_levels_are_compared() {
        for network in Network::ALL {
            let convolutions = network.convolutions();
            assert_eq!(convolutions.iter().filter(|convolution| convolution.is_compared).count(), 5, "{network}");
            for pair in convolutions.windows(2) {
                assert_eq!(pair[0].channels[1], pair[1].channels[0], "{network}: {}", pair[1].index);
            }
        }
        let parameters = |network: Network| -> usize {
            network.tensors().iter().map(|tensor| tensor.shape.iter().product::<usize>()).sum()
        };
        // the numbers of parameters of torchvision's `features`, and of the linear layers
        assert_eq!(parameters(Network::Alex), 2_469_696 + 1152);
        assert_eq!(parameters(Network::Vgg), 14_714_688 + 1472);
    }

    #[test]
    fn the_smallest_pictures_leave_one_pixel() {
        for (network, side) in [(Network::Alex, 31), (Network::Vgg, 16)] {
            assert!(network.fits(side, 100) && network.fits(100, side), "{network}");
            assert!(!network.fits(side - 1, 100) && !network.fits(0, 0), "{network}");
        }
    }
}
