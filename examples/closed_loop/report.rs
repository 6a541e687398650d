//! What is printed and drawn.

use lapwing_score::{
    drawing::chart::{Axis, Chart, Marks, Series},
    score::{Figure, Scorecard},
};

use super::rank::{Compared, Driven, Measure, correlation, with_interval};

/// Prints what each pilot came to along one recording.
pub fn print_drives(compared: &Compared) {
    println!("\n{}\n", compared.name);
    print!("| pilot | autonomy along the recording | on the road |");
    for what in ["interventions", "mean offset", "95th percentile", "largest"] {
        print!(" {what} | on the road |");
    }
    println!(" MSE | MAE | r | rank | on the road |");
    println!("|---|{}", "---|".repeat(15));
    let drives: Vec<&Driven> = compared.drives.iter().collect();
    let ranks = [false, true].map(|on_road| Measure::Interventions.ranks(&drives, on_road));
    for (i, Driven { pilot, replay, road, steering }) in compared.drives.iter().enumerate() {
        print!("| {pilot} |");
        let both = |figure: Figure| {
            let show = |card: &Scorecard| card.value(figure).map_or("-".into(), |value| figure.unit().show(value));
            print!(" {} | {} |", show(replay), show(road));
        };
        [Figure::Autonomy, Figure::Interventions, Figure::MeanCte, Figure::P95Cte, Figure::MaxCte]
            .into_iter()
            .for_each(both);
        let r = steering.r.map_or("-".into(), |r| format!("{r:.3}"));
        println!(" {:.5} | {:.4} | {r} | {} | {} |", steering.mse, steering.mae, ranks[0][i], ranks[1][i]);
    }
}

/// Prints how well each judge ranks the pilots as the simulator does: along each recording, and along all of them.
pub fn print_correlations(all: &[Compared]) {
    let show = |rho: Option<f64>| rho.map_or("-".into(), |rho| format!("{rho:.3}"));
    println!("\nSpearman's rank correlation with the simulator, by {}\n", Measure::Interventions.name());
    println!("| recording | closed loop | open loop, MSE | MAE | r |\n|---|---|---|---|---|");
    for compared in all {
        let one = std::slice::from_ref(compared);
        let [closed, mse, mae, r] = [Measure::Interventions, Measure::Mse, Measure::Mae, Measure::R]
            .map(|along| show(correlation(one, along, Measure::Interventions)));
        println!("| {} | {closed} | {mse} | {mae} | {r} |", compared.name);
    }
    let pilots = all.first().map_or(0, |compared| compared.drives.len());
    println!("\nAll of them: {pilots} pilots, {} drives along recordings\n", pilots * all.len());
    println!(
        "| ranked in the simulator by | {} |\n|---|---|---|---|",
        Measure::DRIVE.map(|on_road| on_road.name()).join(" | ")
    );
    let row = |name: &str, along: &dyn Fn(Measure) -> Measure| {
        print!("| {name} |");
        for on_road in Measure::DRIVE {
            match with_interval(all, along(on_road), on_road) {
                Some((rho, [low, high])) => print!(" {rho:.3} [{low:.2}, {high:.2}] |"),
                None => print!(" - |"),
            }
        }
        println!();
    };
    row("closed loop, by the same", &|on_road| on_road);
    Measure::OPEN.into_iter().for_each(|open| row(open.name(), &|_| open));
}

/// Each pilot's rank along the recordings, closed loop and open loop, over its rank in the simulator.
pub fn draw(all: &[Compared]) -> Chart {
    let pilots = all.first().map_or(0, |compared| compared.drives.len());
    let mean = |measure: Measure, on_road: bool| {
        let mut means = vec![0.0; pilots];
        for compared in all {
            let ranks = measure.ranks(&compared.drives.iter().collect::<Vec<_>>(), on_road);
            means.iter_mut().zip(ranks).for_each(|(mean, rank)| *mean += rank / all.len() as f64);
        }
        means
    };
    let axis = |label: &str| Axis::new(label).from_to(0.0, pilots as f64 + 1.0);
    let title = format!("{pilots} pilots along {} recordings: 1 is the best", all.len());
    let mut chart = Chart::new(title, axis("mean rank in the simulator"), axis("rank"));
    let ends = (1.0, pilots as f64);
    chart.series.push(Series::new("as in the simulator", Marks::Line(vec![(ends.0, ends.0), (ends.1, ends.1)])));
    let road = mean(Measure::Interventions, true);
    // Short, for there is one line for all.
    for (name, measure) in [
        ("open loop, MSE", Measure::Mse),
        ("MAE", Measure::Mae),
        ("r", Measure::R),
        ("closed loop", Measure::Interventions),
    ] {
        let points = road.iter().copied().zip(mean(measure, false)).collect();
        chart.series.push(Series::new(name, Marks::Points(points)));
    }
    chart
}
