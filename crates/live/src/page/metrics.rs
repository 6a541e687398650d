//! `/metrics`: the numbers of all drives as Prometheus reads them (OpenMetrics text).

use std::{
    fmt::{self, Write},
    sync::{Arc, PoisonError},
};

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
use lapwing_score::score::{Figure, Scorer};

/// The content type of the text.
pub(super) const TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// The text.
pub(super) fn text(page: &Arc<Page>) -> Result<String, fmt::Error> {
    let mut registry = Registry::with_prefix("lapwing");
    registry.register_collector(Box::new(Scrape(page.clone())));
    let mut text = String::new();
    encode(&mut text, &registry)?;
    Ok(text)
}

#[derive(Debug)]
struct Scrape(Arc<Page>);

impl Collector for Scrape {
    fn encode(&self, mut encoder: DescriptorEncoder) -> fmt::Result {
        let page = &self.0;
        let drives: Vec<_> = page.drives().iter().map(|drive| (drive.id.to_string(), drive.now())).collect();
        let mut all = *page.ended.lock().unwrap_or_else(PoisonError::into_inner);
        drives.iter().for_each(|(_, now)| all.add(&now.counts));
        let Counts { messages, bad_frames, interventions, stages } = all;
        for (name, help, count) in [
            ("messages", "Telemetries received", messages),
            ("bad_frames", "Telemetries or pictures that could not be used", bad_frames),
            ("interventions", "Times that a human took over or the car was put back", interventions),
        ] {
            let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Counter)?;
            metric.encode_counter::<NoLabelSet, u64, u64>(&count, None)?;
        }
        let help = "Time of an answer, by stage; answer is from message in to answer out";
        let mut metric = encoder.encode_descriptor("latency", help, Some(&Unit::Seconds), MetricType::Histogram)?;
        for (stage, times) in STAGES.into_iter().zip(&stages) {
            histogram(metric.encode_family(&[("stage", stage)])?, times)?;
        }
        let open = page.open.load(std::sync::atomic::Ordering::Relaxed) as u64;
        for (name, help, count) in
            [("drives", "Drives that are open", drives.len() as u64), ("pages", "Pages that look", open)]
        {
            encoder.encode_descriptor(name, help, None, MetricType::Gauge)?.encode_gauge(&count)?;
        }
        gauge(&mut encoder, &drives, "speed_mph", "Speed, in miles an hour", |now| now.turn?.speed_mph)?;
        gauge(&mut encoder, &drives, "telemetries_per_second", "Telemetries a second", |now| Some(now.turn?.hz))?;
        let cards: Vec<_> = drives.iter().map(|(id, now)| (id, now.scorer.as_deref().map(Scorer::clone))).collect();
        let cards: Vec<_> = cards.into_iter().map(|(id, scorer)| (id, scorer.map(Scorer::finish))).collect();
        for figure in Figure::ALL {
            let known = cards.iter().filter_map(|(id, card)| Some((*id, card.as_ref()?.value(figure)?)));
            let known: Vec<_> = known.filter(|(_, value)| value.is_finite()).collect();
            if known.is_empty() {
                continue; // a figure that nobody knows is no 0
            }
            let mut name = "score_".to_owned();
            name.write_str(figure.key())?;
            let mut metric = encoder.encode_descriptor(&name, figure.label(), None, MetricType::Gauge)?;
            for (id, value) in known {
                metric.encode_family(&[("drive", id.as_str())])?.encode_gauge(&value)?;
            }
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

fn gauge(
    encoder: &mut DescriptorEncoder<'_>,
    drives: &[(String, Arc<Moment>)],
    name: &str,
    help: &str,
    value: impl Fn(&Moment) -> Option<f64>,
) -> fmt::Result {
    let mut metric = encoder.encode_descriptor(name, help, None, MetricType::Gauge)?;
    for (id, now) in drives {
        if let Some(value) = value(now) {
            metric.encode_family(&[("drive", id.as_str())])?.encode_gauge(&value)?;
        }
    }
    Ok(())
}
