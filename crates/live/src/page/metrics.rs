//! `/metrics`: the numbers of all drives as Prometheus reads them (OpenMetrics text).

use std::{fmt, sync::Arc};

use futures_util::future::join_all;
use prometheus_client::{
    collector::Collector,
    encoding::{DescriptorEncoder, MetricEncoder, NoLabelSet, text::encode},
    metrics::MetricType,
    registry::{Registry, Unit},
};

use super::{
    Page,
    counts::{BOUNDS_S, Counts, STAGES, Times},
    moment::Moment,
};
use lapwing_score::score::{Figure, Scorecard, Scorer};

/// The content type of the text.
pub(super) const TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// The text.
pub(super) async fn text(page: &Arc<Page>) -> Result<String, fmt::Error> {
    let (ended, drives) = page.counted();
    let scorers = join_all(drives.iter().map(|(drive, _)| drive.scorer())).await;
    let cards = scorers.into_iter().map(|scorer| scorer.map(|scorer| Scorer::clone(&scorer).finish()));
    let drives = drives.into_iter().zip(cards).map(|((drive, now), card)| (drive.id.to_string(), now, card)).collect();
    let mut registry = Registry::with_prefix("lapwing");
    let pages = page.open.taken() as u64;
    registry.register_collector(Box::new(Scrape { drives, ended, pages }));
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

/// All that is told, as it was when it was asked for.
#[derive(Debug)]
struct Scrape {
    /// Of each drive its number, as text, its moment and its score.
    drives: Vec<(String, Arc<Moment>, Option<Scorecard>)>,
    ended: Counts,
    pages: u64,
}

impl Collector for Scrape {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        let mut all = self.ended;
        self.drives.iter().for_each(|(_, now, _)| all.add(&now.counts));
        let Counts { messages, bad_frames, takeovers, interventions, not_recorded, stages } = all;
        for (name, help, count) in [
            ("messages", "Telemetries received, those included that came while a human drove", messages),
            ("bad_frames", "Telemetries or pictures that could not be used", bad_frames),
            ("takeovers", "Times that a human took over", takeovers),
            ("interventions", "Times that the car was put back on the road", interventions),
            ("not_recorded", "Frames and other items of runs that did not make it into their files", not_recorded),
        ] {
            let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
            metric.encode_counter::<NoLabelSet, u64, u64>(&count, None)?;
        }
        let help = "Time of an answer, by stage; answer is from message in to answer out";
        let mut metric = encoder.encode_descriptor("latency", help, Some(&Unit::Seconds), MetricType::Histogram)?;
        for (stage, times) in STAGES.into_iter().zip(&stages) {
            histogram(metric.encode_family(&[("stage", stage)])?, times)?;
        }
        let open = self.drives.len() as u64;
        for (name, help, count) in [("drives", "Drives that are open", open), ("pages", "Pages that look", self.pages)]
        {
            encoder.encode_descriptor(name, help, None, MetricType::Gauge)?.encode_gauge(&count)?;
        }
        self.gauge(&mut encoder, "speed_mph", "Speed, in miles an hour", |now, _| now.turn?.speed_mph)?;
        self.gauge(&mut encoder, "telemetries_per_second", "Telemetries a second", |now, _| Some(now.turn?.hz))?;
        let help = "1 while the drive's run is being written, 0 while it cannot be; absent where no run is wanted";
        let written = |now: &Moment| now.status.file.as_ref().map(|file| f64::from(u8::from(file.trouble.is_none())));
        self.gauge(&mut encoder, "run_being_written", help, |now, _| written(now))?;
        for figure in Figure::ALL {
            let name = format!("score_{}", figure.key());
            self.gauge(&mut encoder, &name, figure.label(), |_, card| card?.value(figure))?;
        }
        Ok(())
    }
}

impl Scrape {
    /// A gauge for each drive that has a value; what nobody knows is no 0, and is not there.
    fn gauge(
        &self,
        encoder: &mut DescriptorEncoder<'_>,
        name: &str,
        help: &str,
        value: impl Fn(&Moment, Option<&Scorecard>) -> Option<f64>,
    ) -> fmt::Result {
        let known = self.drives.iter().filter_map(|(id, now, card)| Some((id, value(now, card.as_ref())?)));
        let known: Vec<_> = known.filter(|(_, value)| value.is_finite()).collect();
        if known.is_empty() {
            return Ok(());
        }
        let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
        for (id, value) in known {
            metric.encode_family(&[("drive", id.as_str())])?.encode_gauge(&value)?;
        }
        Ok(())
    }
}

fn histogram(mut metric: MetricEncoder<'_>, times: &Times) -> fmt::Result {
    let bounds = BOUNDS_S.into_iter().chain([f64::INFINITY]);
    let buckets: Vec<_> = bounds.zip(times.buckets).collect();
    let count = times.buckets.iter().sum();
    metric.encode_histogram::<NoLabelSet>(times.sum_s, count, &buckets, None)
}
