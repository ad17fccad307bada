//! Each cell of the drive's and the homing's state tables: a state, an input, the next state.

use super::*;

const INIT: u32 = Flags::INITIALIZED;
const NOW: Duration = Duration::from_secs(100);
const WANTED: Command = Command::velocity(77);

/// Input of a cycle.
#[derive(Clone, Copy, Debug)]
enum Input {
    /// No inputs.
    Nothing,
    /// Inputs with these flags.
    Reported(u32),
    /// The mailbox answers.
    Answered,
    /// The mailbox refuses.
    Refused,
    /// Inputs with these flags, a minute later.
    Late(u32),
}

use Input::{Answered, Late, Nothing, Refused, Reported};

/// The columns of the table.
const INPUTS: [Input; 9] = [
    Nothing,
    Reported(0),
    Reported(INIT),
    Reported(INIT | Flags::TIMEOUT),
    Reported(Flags::I2T),
    Answered,
    Refused,
    Late(0),
    Late(INIT),
];

fn inputs(flags: u32) -> [u8; 32] {
    let mut bytes = [0; 32];
    bytes[12..16].copy_from_slice(&flags.to_le_bytes());
    bytes
}

fn drive_in(state: DriveState) -> Drive {
    let config = DriveConfig {
        current_max_ma: 1000,
        direction: -1,
    };
    let mut drive = Drive::new(3, config);
    drive.force(state, NOW);
    drive
}

/// Flags that go with a state.
fn usual(state: DriveState) -> u32 {
    match state {
        DriveState::Clear(_) => INIT | Flags::I2T,
        DriveState::Absent
        | DriveState::Identify
        | DriveState::Uncommutated
        | DriveState::Commutate(_)
        | DriveState::Prepare(_) => 0,
        DriveState::Settle(_)
        | DriveState::Ready
        | DriveState::Exhausted
        | DriveState::Refused(..) => INIT,
    }
}

/// The next state for an input. In any case, only a drive that follows executes the wanted command.
fn after(state: DriveState, input: Input) -> DriveState {
    let mut drive = drive_in(state);
    let cycle = |drive: &mut Drive, flags: Option<u32>, now| {
        let bytes = flags.map(inputs);
        let command = drive.cycle(bytes.as_ref().map(|b| &b[..]), Some(WANTED), true, now);
        assert_eq!(command == WANTED, drive.follows(), "{state:?} at {input:?}");
    };
    match input {
        Nothing => cycle(&mut drive, None, NOW),
        Reported(flags) => cycle(&mut drive, Some(flags), NOW),
        Late(flags) => cycle(&mut drive, Some(flags), NOW + Duration::from_secs(60)),
        Answered | Refused => {
            cycle(&mut drive, Some(usual(state)), NOW);
            let (board, number) = (1610, 200);
            let good = if drive.state() == DriveState::Identify {
                Answer::Version(Version { board, number })
            } else {
                Answer::Value(1)
            };
            let refused = CallError::Refused(TmclError::Command);
            let is_good = matches!(input, Answered);
            drive
                .mailbox()
                .pretend(if is_good { Ok(good) } else { Err(refused) });
            cycle(&mut drive, Some(usual(state)), NOW);
        }
    }
    drive.state()
}

fn name(state: DriveState) -> &'static str {
    match state {
        DriveState::Absent => "absent",
        DriveState::Identify => "identify",
        DriveState::Prepare(0) => "prepare",
        DriveState::Prepare(_) => "prepared",
        DriveState::Uncommutated => "uncommutated",
        DriveState::Commutate(_) => "commutate",
        DriveState::Settle(_) => "settle",
        DriveState::Ready => "ready",
        DriveState::Clear(_) => "clear",
        DriveState::Exhausted => "exhausted",
        DriveState::Refused(..) => "refused",
    }
}

#[test]
fn drive_state_machine_each_cell() {
    let call = DriveFault::Call(CallError::Refused(TmclError::Command));
    // Expected, in the order of INPUTS: nothing, flags 0, 15, 15 and 16, 17, answer, error, late 0, late 15.
    let table = [
        (
            DriveState::Absent,
            "absent identify identify identify identify prepare refused identify identify",
        ),
        (
            DriveState::Identify,
            "absent identify identify identify identify prepare refused identify identify",
        ),
        (
            DriveState::Prepare(0),
            "absent prepare prepare prepare prepare prepared refused prepare prepare",
        ),
        (
            DriveState::Prepare(1),
            "absent uncommutated ready ready uncommutated commutate commutate uncommutated ready",
        ),
        (
            DriveState::Uncommutated,
            "absent commutate settle settle clear commutate commutate commutate settle",
        ),
        (
            DriveState::Commutate(NOW),
            "absent commutate settle settle clear commutate commutate refused settle",
        ),
        (
            DriveState::Settle(NOW),
            "absent settle settle settle settle settle settle ready ready",
        ),
        (
            DriveState::Ready,
            "absent uncommutated ready clear clear ready ready uncommutated ready",
        ),
        (
            DriveState::Clear(NOW),
            "absent uncommutated ready clear clear clear refused uncommutated ready",
        ),
        (
            DriveState::Exhausted,
            "absent exhausted exhausted exhausted exhausted exhausted exhausted uncommutated ready",
        ),
        (
            DriveState::Refused(call, NOW),
            "absent refused refused refused refused refused refused identify identify",
        ),
        (
            DriveState::Refused(DriveFault::Commutation, NOW),
            "absent refused refused refused refused refused refused refused refused",
        ),
    ];
    for (state, expected) in table {
        for (input, expected) in INPUTS.into_iter().zip(expected.split(' ')) {
            assert_eq!(
                name(after(state, input)),
                expected,
                "{state:?} at {input:?}"
            );
        }
    }
}

#[test]
fn blocked_drives_do_not_search_commutation() {
    for bit in [1, 2, 3, 5, 6, 7, 12] {
        let state = after(DriveState::Commutate(NOW), Reported(1 << bit));
        assert_eq!(state, DriveState::Uncommutated, "bit {bit}");
    }
    let mut drive = drive_in(DriveState::Uncommutated);
    let command = drive.cycle(Some(&inputs(0)), Some(WANTED), false, NOW);
    assert_eq!(
        (drive.state(), command),
        (DriveState::Uncommutated, Command::default())
    );
}

#[test]
fn commutation_search_depends_on_firmware() {
    let mut drive = drive_in(DriveState::Uncommutated);
    let command = drive.cycle(Some(&inputs(0)), None, true, NOW);
    assert_eq!(command, Command::velocity(-100));
    let mut drive = drive_in(DriveState::Uncommutated);
    let command = drive.cycle(Some(&inputs(0)[..20]), None, true, NOW);
    assert_eq!((command.value, command.mode), (0, Mode::Initialize));
}

#[test]
fn unknown_firmware_or_layout_is_refused_and_named() {
    for (number, len, text) in [
        (
            200,
            20,
            "board 1610 has firmware 2.00 with 20 bytes of inputs",
        ),
        (
            148,
            32,
            "board 1610 has firmware 1.48 with 32 bytes of inputs",
        ),
        (
            132,
            18,
            "board 1610 has firmware 1.32 with 18 bytes of inputs",
        ),
    ] {
        let mut drive = drive_in(DriveState::Identify);
        drive.cycle(Some(&inputs(0)[..len]), None, true, NOW);
        let board = 1610;
        drive
            .mailbox()
            .pretend(Ok(Answer::Version(Version { board, number })));
        drive.cycle(Some(&inputs(0)[..len]), None, true, NOW);
        let why = drive.drive_fault().unwrap().to_string();
        assert!(why.contains(text), "{why}");
    }
}

/// The state of homing after one cycle, and the command of the joint.
fn homed(
    state: HomingState,
    feedback: Feedback,
    outcome: Option<i32>,
    may_move: bool,
    later_ms: u64,
) -> (HomingState, Option<Command>) {
    let (mut homing, mut mailbox) = (Homing::new(HOMING[1]), Mailbox::new(0));
    homing.force(state);
    if let Some(value) = outcome {
        homing.cycle(&feedback, &mut mailbox, may_move, NOW);
        mailbox.pretend(Ok(Answer::Value(value)));
    }
    let now = NOW + Duration::from_millis(later_ms);
    let command = homing.cycle(&feedback, &mut mailbox, may_move, now);
    (homing.state(), command)
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table")]
fn homing_state_machine_each_cell() {
    let (free, pressed) = (
        Feedback {
            velocity_rpm: 156,
            current_ma: 900,
            ..Feedback::default()
        },
        Feedback {
            velocity_rpm: 3,
            current_ma: 501,
            ..Feedback::default()
        },
    );
    let (fastest, strongest) = (
        Feedback {
            velocity_rpm: i32::MIN,
            ..pressed
        },
        Feedback {
            current_ma: i32::MIN,
            ..pressed
        },
    );
    let hold = Some(Command::HOLD);
    let (go, limp) = (Some(Command::velocity(156)), Some(Command::current(0)));
    let late = NOW + Duration::from_millis(300);
    let approach = |pressed| HomingState::Approach(NOW, pressed);
    for (state, feedback, outcome, may_move, later, expected, command) in [
        (
            HomingState::Idle,
            free,
            None,
            true,
            0,
            HomingState::Idle,
            None,
        ),
        (
            HomingState::Done,
            free,
            None,
            true,
            0,
            HomingState::Done,
            None,
        ),
        (
            HomingState::Cancelled,
            free,
            None,
            true,
            0,
            HomingState::Cancelled,
            None,
        ),
        (
            HomingState::Query,
            free,
            None,
            true,
            0,
            HomingState::Query,
            hold,
        ),
        (
            HomingState::Query,
            free,
            Some(1),
            false,
            0,
            HomingState::Done,
            hold,
        ),
        (
            HomingState::Query,
            free,
            Some(0),
            false,
            0,
            HomingState::Query,
            hold,
        ),
        (
            HomingState::Query,
            free,
            Some(0),
            true,
            0,
            approach(0),
            hold,
        ),
        (approach(0), free, None, true, 300, approach(0), go),
        (approach(3), free, None, true, 300, approach(0), go),
        (approach(3), pressed, None, true, 300, approach(4), go),
        (approach(4), pressed, None, true, 100, approach(0), go),
        // Inputs may hold anything.
        (approach(4), fastest, None, true, 300, approach(0), go),
        (
            approach(4),
            strongest,
            None,
            true,
            300,
            HomingState::Rest(late),
            limp,
        ),
        (
            approach(4),
            pressed,
            None,
            true,
            300,
            HomingState::Rest(late),
            limp,
        ),
        (
            approach(0),
            free,
            None,
            false,
            0,
            HomingState::Cancelled,
            hold,
        ),
        (
            approach(0),
            free,
            None,
            true,
            15_001,
            HomingState::Failed(HomingError::NoStop),
            hold,
        ),
        (
            HomingState::Rest(NOW),
            free,
            None,
            true,
            99,
            HomingState::Rest(NOW),
            limp,
        ),
        (
            HomingState::Rest(NOW),
            free,
            None,
            true,
            100,
            HomingState::Preset,
            limp,
        ),
        (
            HomingState::Preset,
            free,
            None,
            true,
            0,
            HomingState::Preset,
            limp,
        ),
        (
            HomingState::Preset,
            free,
            Some(0),
            true,
            0,
            HomingState::Mark,
            limp,
        ),
        (
            HomingState::Mark,
            free,
            None,
            true,
            0,
            HomingState::Mark,
            hold,
        ),
        (
            HomingState::Mark,
            free,
            Some(1),
            true,
            0,
            HomingState::Done,
            hold,
        ),
    ] {
        let found = homed(state, feedback, outcome, may_move, later);
        assert_eq!(
            found,
            (expected, command),
            "{state:?} {outcome:?} {may_move} {later}"
        );
    }
    let active = [
        HomingState::Query,
        approach(2),
        HomingState::Rest(NOW),
        HomingState::Preset,
        HomingState::Mark,
    ];
    for state in active {
        let mut homing = Homing::new(HOMING[0]);
        homing.force(state);
        homing.start();
        assert_eq!(homing.state(), state, "it is under way");
        homing.cancel();
        assert_eq!(homing.state(), HomingState::Cancelled);
        homing.start();
        assert_eq!(homing.state(), HomingState::Query);
    }
}
