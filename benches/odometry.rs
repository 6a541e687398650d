//! What it costs to find a drive on the known roads: telemetries a second, 200 of which may come live.

use divan::{Bencher, counter::ItemsCount};
use lapwing::known::Roads;
use lapwing_core::motion::Motion;
use lapwing_score::odometry::Matcher;
use lapwing_sim::track::Track;

/// Of a drive at 20 mph that tells 15 a second.
const TELEMETRIES: usize = 1500;

/// A drive around the lake from an unknown place, matched with the lake, the jungle and the mountain at once.
#[divan::bench(sample_count = 10, sample_size = 1)]
fn matched_with_three_roads(bencher: Bencher) {
    let lake = Track::named("lake").unwrap();
    let line = lake.driving_line();
    let motions: Vec<Motion> = (0..TELEMETRIES)
        .map(|i| {
            let point = line[(700 + i) % line.len()];
            Motion { way_m: 0.5, turn_rad: 0.5 * point.curvature }
        })
        .collect();
    let roads = Roads::default().known().unwrap();
    bencher.counter(ItemsCount::new(TELEMETRIES)).bench_local(|| {
        let mut matcher = Matcher::new(roads.iter().cloned(), 1);
        motions.iter().for_each(|motion| matcher.step(*motion));
        assert_eq!(matcher.matches()[0].road.name, "lake");
    });
}
