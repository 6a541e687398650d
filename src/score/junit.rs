//! Thresholds as the test cases of a JUnit report, which every CI shows.

use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use super::{Check, Figure, Scorecard};

/// A report with a suite for each run and a case for each threshold; a run without thresholds has one case, that it was
/// scored. The scorecard is the suite's output.
///
/// # Errors
/// Where the XML cannot be written.
pub fn report(runs: &[(String, &Scorecard, Vec<Check>)]) -> Result<String, quick_junit::SerializeError> {
    let mut report = Report::new("lapwing score");
    for (name, card, checks) in runs {
        let mut suite = TestSuite::new(name.as_str());
        for check in checks {
            let mut status = TestCaseStatus::success();
            if !check.passed {
                status = TestCaseStatus::non_success(NonSuccessKind::Failure);
                status.set_message(check.words.as_str()).set_type("threshold");
            }
            suite.add_test_case(case(name, check.name, status));
        }
        if checks.is_empty() {
            suite.add_test_case(case(name, "scored", TestCaseStatus::success()));
        }
        for figure in Figure::ALL {
            if let Some(value) = card.value(figure) {
                suite.add_property((figure.key(), value.to_string().as_str()));
            }
        }
        suite.set_system_out(card.to_string());
        report.add_test_suite(suite);
    }
    report.to_string()
}

fn case(run: &str, name: &str, status: TestCaseStatus) -> TestCase {
    let mut case = TestCase::new(name, status);
    case.set_classname(run);
    case
}
