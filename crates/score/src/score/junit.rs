//! Thresholds as the test cases of a JUnit report, which every CI shows.

use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use super::{
    Check, Figure, Measure, Scorecard,
    against::{Comparison, Trend},
};

/// A report with a suite for each run and a case for each threshold; a run without thresholds has a single case, that
/// it was scored. The scorecard is the suite's output. Runs that could not be scored are errors; the comparison with a
/// baseline is a suite of its own, with a case for each figure.
///
/// # Errors
/// Where the XML cannot be written.
pub fn report(
    runs: &[(String, &Scorecard, Vec<Check>)],
    unscored: &[(String, String)],
    against: Option<&Comparison>,
) -> Result<String, quick_junit::SerializeError> {
    let mut report = Report::new("lapwing score");
    for (name, card, checks) in runs {
        let mut suite = TestSuite::new(name.as_str());
        for check in checks {
            let failed = (!check.passed).then_some(check.words.as_str());
            suite.add_test_case(case(name, check.name, status(failed, "threshold")));
        }
        if checks.is_empty() {
            suite.add_test_case(case(name, "scored", TestCaseStatus::success()));
        }
        for figure in Figure::ALL {
            let measure = card.get(figure);
            if let Some(value) = measure.value() {
                suite.add_property((figure.key(), value.to_string().as_str()));
            }
            if let Measure::Estimate { uncertainty, .. } = measure {
                let key = format!("{}.uncertainty", figure.key());
                suite.add_property((key.as_str(), uncertainty.to_string().as_str()));
            }
        }
        suite.set_system_out(card.to_string());
        report.add_test_suite(suite);
    }
    for (name, why) in unscored {
        let mut status = TestCaseStatus::non_success(NonSuccessKind::Error);
        status.set_message(why.as_str()).set_type("unreadable");
        let mut suite = TestSuite::new(name.as_str());
        suite.add_test_case(case(name, "scored", status));
        report.add_test_suite(suite);
    }
    if let Some(against) = against {
        let mut suite = TestSuite::new("against the baseline");
        for change in &against.changes {
            let words = change.to_string();
            let failed = (change.turn == Trend::Worse).then_some(words.as_str());
            suite.add_test_case(case(&change.setting, change.figure, status(failed, "worse")));
        }
        for setting in &against.missing {
            suite.add_test_case(case(setting, "driven", status(Some("no run, but the baseline has one"), "worse")));
        }
        for setting in &against.damaged {
            suite.add_test_case(case(
                setting,
                "whole",
                status(Some("a run is damaged, and what is lost may be worse"), "worse"),
            ));
        }
        report.add_test_suite(suite);
    }
    report.to_string()
}

/// A success, or a failure of this kind with a message.
fn status(failed: Option<&str>, kind: &str) -> TestCaseStatus {
    let Some(message) = failed else { return TestCaseStatus::success() };
    let mut status = TestCaseStatus::non_success(NonSuccessKind::Failure);
    status.set_message(message).set_type(kind);
    status
}

fn case(run: &str, name: &str, status: TestCaseStatus) -> TestCase {
    let mut case = TestCase::new(name, status);
    case.set_classname(run);
    case
}
