// What is shared between threads and processes: the mailbox, the ring, and files made from it. Also run under TSan.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <filesystem>
#include <thread>

#include "station/mailbox.hpp"
#include "station/mcap_writer.hpp"
#include "station/recorder.hpp"
#include "station/telemetry.hpp"

namespace hapticlod::station {
namespace {

struct Pair {
    std::uint64_t value = 0, twice = 0;
    std::array<std::uint64_t, 20> same{};
};

TEST(Mailbox, ConsumerSeesWholeValuesInOrderAndTheLast) {
    constexpr std::uint64_t kLast = 200'000;
    Mailbox<Pair> mailbox;
    EXPECT_EQ(mailbox.take(), nullptr);
    std::uint64_t seen = 0, taken = 0;
    std::thread consumer([&] {
        while (seen < kLast) {
            const std::uint32_t posts = mailbox.posts();
            const Pair* pair = mailbox.take();
            if (pair == nullptr) {
                mailbox.wait(posts);
                continue;
            }
            ASSERT_GT(pair->value, seen);
            ASSERT_EQ(pair->twice, 2 * pair->value);
            for (const std::uint64_t copy : pair->same) ASSERT_EQ(copy, pair->value);
            seen = pair->value;
            ++taken;
        }
    });
    for (std::uint64_t i = 1; i <= kLast; ++i) {
        Pair& slot = mailbox.slot();
        slot.value = i;
        slot.twice = 2 * i;
        slot.same.fill(i);
        mailbox.post();
    }
    consumer.join();
    EXPECT_EQ(seen, kLast);
    EXPECT_LE(taken, kLast);
}

TelemetrySource source(double loop_hz = 1000.0) {
    TelemetrySource made{};
    made.pid = static_cast<std::uint32_t>(::getpid());
    made.loop_hz = loop_hz;
    made.level_count = 2;
    made.start_unix_ns = 1'700'000'000'000'000'000;
    return made;
}

TelemetryFrame frame(std::uint64_t i) {
    TelemetryFrame made{};
    made.now_ns = static_cast<std::int64_t>(i) * 1'000'000;
    made.device_s = 1e-3 * static_cast<double>(i);
    for (int axis = 0; axis < 3; ++axis) made.position_mm[axis] = made.scp_mm[axis] = static_cast<double>(i + 3);
    made.orientation[0] = 1.0f;
    made.force_n[2] = 0.5f;
    made.lost = static_cast<std::uint16_t>(i);
    return made;
}

TEST(Telemetry, KeepsTheNewestFramesAndForgetsTheOld) {
    auto ring = TelemetryRing::create(source(), 1.0);
    ASSERT_TRUE(ring) << ring.fault().line();
    for (std::uint64_t i = 0; i < 3000; ++i) ring.value().push(frame(i));
    const std::uint64_t capacity = ring.value().capacity();
    EXPECT_EQ(capacity, 1024u);
    TelemetryFrame got;
    EXPECT_FALSE(ring.value().read(3000 - capacity - 1, got));
    EXPECT_FALSE(ring.value().read(3000, got));
    ASSERT_TRUE(ring.value().read(3000 - capacity, got));
    EXPECT_EQ(got.device_s, frame(3000 - capacity).device_s);
    const auto last = ring.value().newest(10);
    ASSERT_EQ(last.size(), 10u);
    for (std::size_t i = 0; i < 10; ++i) EXPECT_EQ(last[i].now_ns, frame(2990 + i).now_ns);
    EXPECT_EQ(ring.value().newest(1u << 20).size(), capacity);
}

TEST(Telemetry, ReadersNeverSeeHalfAFrame) {
    auto writer = TelemetryRing::create(source(), 1.0);
    ASSERT_TRUE(writer);
    auto reader = TelemetryRing::open(static_cast<std::uint32_t>(::getpid()));
    ASSERT_TRUE(reader) << reader.fault().line();
    std::atomic<bool> done{false};
    std::uint64_t whole = 0;
    std::thread thread([&] {
        TelemetryFrame got;
        while (!done.load()) {
            const std::uint64_t end = reader.value().pushed();
            // The newest and the oldest: the one is just being finished, the other just being overwritten.
            for (const std::uint64_t index : {end - 1, end - reader.value().capacity()}) {
                if (end < reader.value().capacity() || !reader.value().read(index, got)) continue;
                const TelemetryFrame expected = frame(index);
                ASSERT_EQ(std::memcmp(&got, &expected, sizeof(got)), 0);
                ++whole;
            }
        }
    });
    for (std::uint64_t i = 0; i < 300'000; ++i) writer.value().push(frame(i));
    while (whole == 0 && writer.value().pushed() < 3'000'000) writer.value().push(frame(writer.value().pushed()));
    done = true;
    thread.join();
    EXPECT_GT(whole, 0u);
}

TEST(Telemetry, OtherUsersStationsLive) {
    EXPECT_TRUE(process_lives(1));  // may not be signalled by everybody
    EXPECT_TRUE(process_lives(static_cast<std::uint32_t>(::getpid())));
    EXPECT_FALSE(process_lives(4194305));  // more than there can be
}

TEST(Telemetry, WhatADeadStationLeftIsNotAStation) {
    const pid_t child = ::fork();
    if (child == 0) {  // dies without saying goodbye
        auto ring = TelemetryRing::create(source(), 1.0);
        ::_exit(ring ? 0 : 1);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_EQ(status, 0);
    const std::string left = "/dev/shm/hapticlod-station." + std::to_string(child);
    ASSERT_TRUE(std::filesystem::exists(left));
    {
        auto ring = TelemetryRing::create(source(), 1.0);
        ASSERT_TRUE(ring);
        EXPECT_FALSE(std::filesystem::exists(left));
    }
    EXPECT_FALSE(TelemetryRing::open(static_cast<std::uint32_t>(::getpid())));
}

TEST(Recorder, FollowsARunningRing) {
    const std::string path = "/tmp/hapticlod-recorder-" + std::to_string(::getpid()) + ".mcap";
    auto ring = TelemetryRing::create(source(), 2.0);
    ASSERT_TRUE(ring);
    auto recorder = Recorder::start(path, ring.value());
    ASSERT_TRUE(recorder) << recorder.fault().line();
    EXPECT_FALSE(std::filesystem::exists(path));  // beside, until it is whole
    for (std::uint64_t i = 0; i < 1500; ++i) ring.value().push(frame(i));
    EXPECT_FALSE(recorder.value()->stop());
    EXPECT_EQ(recorder.value()->recorded(), 1500u);
    EXPECT_EQ(recorder.value()->missed(), 0u);
    EXPECT_TRUE(std::filesystem::exists(path));
    EXPECT_FALSE(std::filesystem::exists(path + ".part"));
    std::filesystem::remove(path);
}

TEST(Recorder, PlaceThatCannotBeWrittenIsAFault) {
    auto ring = TelemetryRing::create(source(), 1.0);
    ASSERT_TRUE(ring);
    const auto recorder = Recorder::start("/nowhere/at/all.mcap", ring.value());
    ASSERT_FALSE(recorder);
    EXPECT_EQ(recorder.fault().where, "/nowhere/at/all.mcap");
}

TEST(Crc32, HasTheStandardCheckValue) { EXPECT_EQ(crc32_ieee("123456789"), 0xCBF43926u); }

}  // namespace
}  // namespace hapticlod::station
