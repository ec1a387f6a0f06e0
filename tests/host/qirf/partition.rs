//! Blocks: each Gaussian in exactly one, caps respected, degenerate positions.

use proptest::prelude::*;
use qirf_vk::qirf::partition::{Partition, Partitioned};
use qirf_vk::random::uniform;

fn check(positions: &[[f32; 3]], rule: Partition) -> Partitioned {
    let made = rule.of(positions);
    let blocks = &made.blocks;
    let most = match rule {
        Partition::Paper { cap, .. } => cap,
        Partition::Adaptive { most, .. } => most,
    };
    assert_eq!((blocks.starts[0], *blocks.starts.last().unwrap() as usize), (0, positions.len()));
    let mut seen = vec![false; positions.len()];
    for block in blocks.iter() {
        assert!(!block.is_empty() && block.len() <= most, "{} members", block.len());
        assert!(block.is_sorted_by(|a, b| a < b));
        for &i in block {
            assert!(!std::mem::replace(&mut seen[i as usize], true));
        }
    }
    assert!(seen.iter().all(|&s| s));
    made
}

fn cloud(n: usize, seed: u64) -> Vec<[f32; 3]> {
    (0..n as u64).map(|i| std::array::from_fn(|c| (4.0 * uniform(&[seed, i, c as u64]) - 2.0) as f32)).collect()
}

/// Points on the surface of a sphere, since scenes are surfaces.
fn shell(n: usize) -> Vec<[f32; 3]> {
    let point = |p: [f32; 3]| {
        let length = p.iter().map(|x| x * x).sum::<f32>().sqrt().max(1e-6);
        p.map(|x| 3.0 * x / length)
    };
    cloud(n, 9).into_iter().map(point).collect()
}

#[test]
fn no_gaussian_makes_no_block() {
    for rule in [Partition::PAPER, Partition::ADAPTIVE] {
        assert!(rule.of(&[]).blocks.is_empty());
        assert_eq!(check(&[[1.0; 3]], rule).blocks.len(), 1);
    }
}

#[test]
fn faces_belong_to_the_voxel_above_and_negative_coordinates_have_their_own() {
    let rule = Partition::Paper { voxel: 0.5, cap: 4096 };
    // Enough points that the voxel is not doubled.
    let mut positions = vec![[0.25_f32, 0.25, 0.25]; 40];
    positions.extend([[0.5, 0.0, 0.0], [0.499_999_97, 0.0, 0.0], [-0.0, 0.0, 0.0], [-1e-30, 0.0, 0.0]]);
    let made = check(&positions, rule);
    let block_of = |i: u32| made.blocks.iter().position(|b| b.contains(&i)).unwrap();
    assert!(!made.doubled);
    assert_eq!(block_of(41), block_of(0));
    assert_eq!(block_of(42), block_of(0));
    assert_ne!(block_of(40), block_of(0));
    assert_ne!(block_of(43), block_of(0));
    assert_eq!(made.blocks.len(), 3);
}

#[test]
fn a_sparse_scene_doubles_the_papers_voxel() {
    let spread: Vec<[f32; 3]> = (0..100).map(|i| [i as f32, 0.0, 0.0]).collect();
    let made = check(&spread, Partition::PAPER);
    assert!(made.doubled && (made.voxel - 0.06).abs() < 1e-12);
}

#[test]
fn a_full_voxel_is_split_and_counted() {
    let positions: Vec<[f32; 3]> = cloud(11_000, 1).into_iter().map(|p| p.map(|x| 0.015 + x * 0.005)).collect();
    let paper = check(&positions, Partition::PAPER);
    assert_eq!((paper.split, paper.fullest, paper.blocks.len()), (1, 11_000, 4));
    let adaptive = check(&positions, Partition::ADAPTIVE);
    assert!(adaptive.blocks.iter().all(|b| b.len() >= 8));
}

#[test]
fn coincident_points_are_split_by_index() {
    let positions = vec![[1.5_f32, -2.0, 0.25]; 1_000_000];
    // 128 and 4,096 at most, by halving: 2^13 blocks of 122 or 123, 2^8 of 3,906 or 3,907.
    for (rule, count) in [(Partition::ADAPTIVE, 8192), (Partition::PAPER, 256)] {
        let made = check(&positions, rule);
        assert_eq!((made.blocks.len(), made.split, made.fullest), (count, 1, 1_000_000));
        assert!(made.blocks.iter().all(|b| *b.last().unwrap() as usize - b[0] as usize == b.len() - 1));
    }
}

/// Blocks are made on the host alone, so that they are the same for every device; the number of threads does not matter
/// either.
#[test]
fn one_thread_makes_the_same_blocks_as_many() {
    let mut positions = shell(60_000);
    positions.extend(vec![[0.5; 3]; 40_000]);
    positions.extend(cloud(5000, 3).into_iter().map(|p| p.map(|x| (x * 20.0).round() * 0.03)));
    positions.push([1e7; 3]);
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    for rule in [Partition::ADAPTIVE, Partition::PAPER] {
        let made = check(&positions, rule);
        assert_eq!(made, alone.install(|| rule.of(&positions)));
        assert_eq!(made, rule.of(&positions));
    }
}

#[test]
fn flyaways_and_what_is_no_number_do_not_spoil_the_rest() {
    let clean = check(&shell(20_000), Partition::ADAPTIVE);
    let mut positions = shell(20_000);
    positions.extend([[1e7; 3], [-1e30, 0.0, 0.0], [f32::NAN, 0.0, 0.0], [f32::INFINITY; 3], [f32::MIN; 3]]);
    let made = check(&positions, Partition::ADAPTIVE);
    assert!((made.voxel / clean.voxel - 1.0).abs() < 0.05);
    let mean = 20_000.0 / made.blocks.len() as f64;
    assert!((24.0..72.0).contains(&mean), "{mean}");
    assert!(made.blocks.iter().filter(|b| b.len() < 8).count() <= 1);
    check(&positions, Partition::PAPER);
}

#[test]
fn the_adaptive_rule_meets_its_occupancy_at_any_scale() {
    for scale in [1e-6_f32, 1.0, 1e6] {
        let positions: Vec<[f32; 3]> = shell(30_000).into_iter().map(|p| p.map(|x| x * scale)).collect();
        let made = check(&positions, Partition::ADAPTIVE);
        let mean = 30_000.0 / made.blocks.len() as f64;
        assert!((30.0..70.0).contains(&mean), "{mean} at {scale}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_positions_are_partitioned(
        positions in prop::collection::vec(prop::array::uniform3(prop_oneof![
            6 => -3.0_f32..3.0, 1 => Just(0.0_f32), 1 => Just(0.03_f32), 1 => any::<f32>()
        ]), 1..300),
        least in 1..12_usize, most in 1..40_usize, voxel in 1e-3..1.0_f64,
    ) {
        check(&positions, Partition::Adaptive { mean: 10, least, most });
        check(&positions, Partition::Paper { voxel, cap: most });
    }
}
