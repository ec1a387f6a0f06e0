//! PLY files are read in blocks of 4 MiB; what is not that plain is read whole.

use std::fs;

use qirf_vk::gaussians::formats::{self, RenderMode};

use crate::support::files::make;

/// Both ways give the same model, and the same faults.
#[test]
fn a_file_read_in_blocks_is_the_model_of_its_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    for (n, degree) in [(40_000, 3), (70_000, 0), (1, 1), (0, 2)] {
        let mut model = make::model(n, degree);
        if n > 30_000 {
            model.means[30_000] = [f32::NAN; 3];
            model.opacity_logits[n - 1] = f32::INFINITY;
        }
        formats::write_at(&path, &model, RenderMode::AntiAliased, [1e6, 0.0, -5.0]).unwrap();
        let bytes = fs::read(&path).unwrap();
        let cut = &bytes[..bytes.len() - 1];
        for content in [&bytes[..], cut, &[&bytes[..], b"rest"].concat()] {
            fs::write(&path, content).unwrap();
            let [blocks, whole] = [formats::read(&path), formats::read_bytes(content, &path)]
                .map(|read| read.map_err(|error| error.to_string()));
            assert!(blocks == whole, "{n} Gaussians of degree {degree}, {} bytes", content.len());
            let cleaned = n - usize::from(n > 30_000);
            assert!(whole.is_err() || whole.is_ok_and(|whole| whole.gaussians.len() == cleaned));
        }
    }
}
