//! When a drive came back to where it began, by its pictures: a lap, on whatever road.

use super::Look;

/// Metres between looks worth taking; within the first [`BEGINNING_M`], one every metre.
pub const EVERY_M: f64 = 3.0;
/// How much of the drive's beginning is searched for later, in metres.
pub const BEGINNING_M: f64 = 45.0;
/// A look is compared with one of the beginning that is this near to its place, in metres.
const NEAR_M: f64 = 0.6;
/// No road is shorter, in metres.
const SHORTEST_M: f64 = 100.0;
/// Fewest looks in a row, and how well they must agree on average; a shorter row, at the end of a drive, must agree
/// better. Rows of looks at other places agree by 0.3 at most.
const ROW: (usize, f64) = (6, 0.45);
const FEW: f64 = 0.62;
/// A row that agrees by less than this share of the best one only resembles the beginning.
const BESIDE_BEST: f64 = 0.6;

/// How far the car had driven each time it came back to where the drive began, in metres. `looks` are in order of the
/// metres driven until then.
pub fn laps(looks: &[(f64, Look)]) -> Vec<f64> {
    let Some(from) = looks.first().map(|(way, _)| *way) else { return vec![] };
    let until = looks.partition_point(|(way, _)| *way <= from + BEGINNING_M);
    let (beginning, _) = looks.split_at(until);
    let far = looks.last().map_or(0.0, |(way, _)| way - from);
    let mut found: Vec<(f64, f64)> = vec![];
    for metres in SHORTEST_M as u32..=far.max(0.0) as u32 + 1 {
        let lap = f64::from(metres);
        let first = looks.partition_point(|(way, _)| *way < from + lap - NEAR_M);
        let again = looks[first..].iter().take_while(|(way, _)| *way <= from + lap + BEGINNING_M);
        let pairs = again.filter_map(|(way, look)| {
            let then = way - lap;
            let after = beginning.partition_point(|(way, _)| *way < then);
            let near =
                beginning[after.saturating_sub(1)..].iter().take(2).filter(|(way, _)| (way - then).abs() <= NEAR_M);
            near.map(|(_, before)| before.agrees(look)).reduce(f64::max)
        });
        let (count, sum) = pairs.fold((0, 0.0), |(count, sum), agrees| (count + 1, sum + agrees));
        let mean = sum / f64::from(count.max(1));
        let least = if count as usize >= ROW.0 { ROW.1 } else { FEW };
        if count == 0 || mean < least {
            continue;
        }
        // Of matches near one another, the best is the place.
        match found.last_mut() {
            Some((at, best)) if lap - *at < SHORTEST_M => {
                if mean > *best {
                    (*at, *best) = (lap, mean);
                }
            }
            _ => found.push((lap, mean)),
        }
    }
    let best = found.iter().fold(0.0, |best, (_, mean)| f64::max(best, *mean));
    found.into_iter().filter(|(_, mean)| *mean >= BESIDE_BEST * best).map(|(lap, _)| lap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use lapwing_core::perception::Frame;

    /// The look of a place: blocks that change every 4 m.
    fn look(place: f64) -> Look {
        let level = |step: f64, cell: usize| {
            let mixed = (step as u32).wrapping_mul(40_503) ^ (cell as u32).wrapping_mul(2_654_435_761);
            f64::from(mixed.wrapping_mul(2_246_822_519) >> 24)
        };
        let (step, part) = ((place / 4.0).floor(), (place / 4.0).fract());
        let cell = |i: usize| [(level(step, i) * (1.0 - part) + level(step + 1.0, i) * part) as u8; 3];
        Look::of(&Frame::new(40, 20, (0..800).flat_map(cell).collect()).unwrap()).unwrap()
    }

    /// Looks of a drive around a road of this length, which reports its distance a hundredth too long.
    fn drive(length: f64, metres: f64) -> Vec<(f64, Look)> {
        let mut looks = vec![];
        let mut way = 0.0;
        while way < metres {
            looks.push((1.01 * way, look(way % length)));
            way += if way < BEGINNING_M { 1.0 } else { EVERY_M };
        }
        looks.push((1.01 * metres, look(metres % length))); // the last one is always taken
        looks
    }

    #[test]
    fn each_time_that_the_beginning_comes_again_is_a_lap() {
        let found = laps(&drive(400.0, 1000.0));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!((found[0] - 404.0).abs() < 3.0 && (found[1] - 808.0).abs() < 3.0, "{found:?}");
    }

    #[test]
    fn a_drive_that_ends_at_its_beginning_has_driven_the_lap() {
        assert_eq!(laps(&drive(400.0, 400.3)).len(), 1);
    }

    #[test]
    fn a_drive_that_does_not_come_back_has_none() {
        assert_eq!(laps(&drive(4000.0, 1000.0)), [0.0; 0]);
        assert_eq!(laps(&[]), [0.0; 0]);
    }
}
