//! How a session ends: a drive that ends in fault or with power has failed, and the verdict says why.

use super::*;

/// A fault in the cycle of switching off.
#[test]
fn can_drive_fault_at_shutdown_fails() {
    let mut lab = lab();
    let begun = lab.now();
    let report = run(&mut lab, plan());
    assert_eq!(
        report.diagnosis,
        None,
        "{}",
        super::super::text::verdict(&report)
    );
    let enabled =
        |step: &&super::super::session::Step| step.status.state() == Ok(State::OperationEnabled);
    let last = report.steps.iter().rfind(enabled).unwrap().at;
    let off = report.steps.iter().find(|step| step.at > last).unwrap().at;
    // The same session, with a fault just before that.
    let mut lab = self::lab();
    let at = u64::try_from((begun + off).as_millis()).unwrap() - 5;
    lab.at(at, |devices| axis(devices).fault(FaultCode::ENCODER));
    let (cause, text) = diagnosed(&mut lab, plan());
    assert_eq!(cause.name(), "fault", "{text}");
    for words in [
        "603Fh:00 error code: incremental encoder 1",
        "1003h:01 last error: ",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn can_drive_that_keeps_power_fails() {
    let mut lab = lab();
    // A service tool takes it over, and it ignores 6040h from then on.
    lab.at(800, |devices| axis(devices).local = true);
    let held = Plan {
        hold: Duration::from_secs(1),
        ..plan()
    };
    let report = run(&mut lab, held);
    let cause = report.diagnosis.as_ref().map(|diagnosis| diagnosis.cause);
    assert_eq!(cause, Some(Cause::StaysPowered(State::OperationEnabled)));
    let text = super::super::text::verdict(&report);
    assert!(text.contains("FAIL  it does not switch off"), "{text}");
}

#[test]
fn can_drive_emergency_without_fault_is_noted() {
    let mut lab = lab();
    let warning = Frame::new(
        node(5).cob(takt_can::canopen::EMERGENCY),
        &[0x10, 0x42, 8, 0, 0, 0, 0, 0],
    );
    lab.other_master
        .push((Duration::from_millis(400), warning.unwrap()));
    let report = run(&mut lab, plan());
    assert_eq!(report.diagnosis, None);
    let text = super::super::text::verdict(&report);
    assert!(
        text.contains("note: emergency: device too hot (4210h)"),
        "{text}"
    );
}

/// Two drives of one number are both enabled by one session.
#[test]
fn can_drive_of_a_duplicate_number_is_refused() {
    let mut lab = lab();
    let mut twin = DriveNodeConfig::new(node(5));
    twin.identity.serial = 99;
    lab.add_drive(twin);
    lab.run(20);
    lab.sent.clear();
    let report = run(&mut lab, plan());
    let cause = report.diagnosis.as_ref().map(|diagnosis| diagnosis.cause);
    assert_eq!(cause, Some(Cause::Duplicate));
    let text = super::super::text::verdict(&report);
    assert!(text.contains("several devices have its number"), "{text}");
    let is_download = |(_, frame): &(Duration, Frame)| {
        matches!(Message::decode(frame), Message::SdoRequest(_, message)
            if matches!(Request::decode(&message), Some(Request::Download { .. })))
    };
    assert!(!lab.sent.iter().any(is_download));
}
