//! LPIPS weights from a safetensors file.

use super::conv::Conv;
use super::rows::Pool;
use super::{Error, Kind, Lpips, Stage};
use safetensors::{Dtype, SafeTensors};
use std::path::Path;

/// Larger than any LPIPS file: VGG16's has 59 MB.
const LARGEST: u64 = 256 << 20;

/// Output channels, window size, stride and padding.
type Shape = (usize, usize, usize, usize);

impl Lpips {
    /// Reads a file written by `tools/lpips-weights` and recognises the network by its tensors.
    ///
    /// # Errors
    /// [`Error::Read`], or [`Error::Weights`] naming the tensor that is missing, misshapen or not finite.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        let read = |source| Error::Read { path: path.to_path_buf(), source };
        let bytes = std::fs::metadata(path).map_err(read)?.len();
        if bytes > LARGEST {
            return Err(Error::weights(path, format!("{bytes} bytes are too many for LPIPS weights (59 MB at most)")));
        }
        let data = std::fs::read(path).map_err(read)?;
        let file = SafeTensors::deserialize(&data)
            .map_err(|e| Error::weights(path, format!("is not a complete safetensors file ({e})")))?;
        let file = File { path, file };

        let (kind, stages) = match file.shape("conv0.weight")?[..] {
            [64, 3, 3, 3] => (Kind::Vgg, vgg()),
            [64, 3, 11, 11] => (Kind::Alex, alex()),
            ref other => {
                let what = format!("conv0.weight has the shape {other:?}, neither VGG16's nor AlexNet's");
                return Err(Error::weights(path, what));
            }
        };
        let (mut inputs, mut number) = (3, 0);
        let mut built = Vec::with_capacity(stages.len());
        for (layer, (shapes, pool)) in stages.into_iter().enumerate() {
            let mut convs = Vec::with_capacity(shapes.len());
            for (outputs, size, stride, pad) in shapes {
                let weight = file.tensor(&format!("conv{number}.weight"), &[outputs, inputs, size, size])?;
                let bias = file.tensor(&format!("conv{number}.bias"), &[outputs])?;
                convs.push(Conv::new(&weight, bias, inputs, size, stride, pad));
                (inputs, number) = (outputs, number + 1);
            }
            built.push(Stage { convs, head: file.tensor(&format!("lin{layer}"), &[inputs])?, pool });
        }
        Ok(Self { kind, stages: built })
    }
}

/// VGG16's convolutions by stage, each stage but the last followed by a 2 x 2 pool.
fn vgg() -> Vec<(Vec<Shape>, Option<Pool>)> {
    let pool = Some(Pool { size: 2, stride: 2 });
    let stage = |channels, count, pool| (vec![(channels, 3, 1, 1); count], pool);
    vec![stage(64, 2, pool), stage(128, 2, pool), stage(256, 3, pool), stage(512, 3, pool), stage(512, 3, None)]
}

/// AlexNet's convolutions, the first two followed by a 3 x 3 pool of stride 2.
fn alex() -> Vec<(Vec<Shape>, Option<Pool>)> {
    let pool = Some(Pool { size: 3, stride: 2 });
    vec![
        (vec![(64, 11, 4, 2)], pool),
        (vec![(192, 5, 1, 2)], pool),
        (vec![(384, 3, 1, 1)], None),
        (vec![(256, 3, 1, 1)], None),
        (vec![(256, 3, 1, 1)], None),
    ]
}

struct File<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
}

impl File<'_> {
    fn shape(&self, name: &str) -> Result<Vec<usize>, Error> {
        let tensor = self.file.tensor(name);
        let tensor = tensor.map_err(|_| Error::weights(self.path, format!("holds no tensor {name}")))?;
        Ok(tensor.shape().to_vec())
    }

    /// The values of a tensor that must have this shape.
    fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, Error> {
        let wrong = |what: String| Error::weights(self.path, what);
        let tensor = self.file.tensor(name).map_err(|_| wrong(format!("holds no tensor {name}")))?;
        if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
            let (dtype, found) = (tensor.dtype(), tensor.shape());
            return Err(wrong(format!("{name} is {dtype:?} of shape {found:?}; expected F32 of {shape:?}")));
        }
        let (words, _) = tensor.data().as_chunks::<4>();
        let values: Vec<f32> = words.iter().map(|&w| f32::from_le_bytes(w)).collect();
        match values.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(wrong(format!("{name} holds {} at element {at}", values[at]))),
            None => Ok(values),
        }
    }
}
