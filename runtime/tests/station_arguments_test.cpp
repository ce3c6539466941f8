// The station's command line.
#include <gtest/gtest.h>

#include "station/arguments.hpp"

namespace hapticlod::station {
namespace {

TEST(Arguments, SayWhatIsWrong) {
    const ArgumentRules rules{{"BUNDLE"}, {"--seconds"}, {"--json"}};
    const auto fault = [&rules](std::vector<std::string_view> words) {
        const auto parsed = Arguments::parse(words, rules);
        return parsed ? std::string("fine") : parsed.fault().line();
    };
    EXPECT_EQ(fault({"a.hlod", "--seconds", "3", "--json"}), "fine");
    EXPECT_EQ(fault({}).substr(0, 18), "BUNDLE: is missing");
    EXPECT_NE(fault({"a", "b"}).find("b: is one argument too many"), std::string::npos);
    EXPECT_NE(fault({"a", "--second", "3"}).find("--second: is no option"), std::string::npos);
    EXPECT_NE(fault({"a", "--seconds"}).find("--seconds: needs a value"), std::string::npos);
    EXPECT_NE(fault({"a", "--json", "--json"}).find("given twice"), std::string::npos);
    EXPECT_NE(fault({"a", "--json=1"}).find("--json: is no option"), std::string::npos);
    const std::vector<std::string_view> words = {"a", "--seconds=2.5"};
    const auto parsed = Arguments::parse(words, rules);
    ASSERT_TRUE(parsed);
    EXPECT_EQ(parsed.value().number("--seconds", 1.0, 0.0, 10.0).value(), 2.5);
    EXPECT_FALSE(parsed.value().number("--seconds", 1.0, 0.0, 2.0));
    for (const char* bad : {"nan", "x", "1s", "", "inf", "-1"}) {
        const std::string word = std::string("--seconds=") + bad;
        const std::vector<std::string_view> wrong = {"a", word};
        EXPECT_FALSE(Arguments::parse(wrong, rules).value().number("--seconds", 1.0, 0.0, 10.0)) << bad;
    }
}

}  // namespace
}  // namespace hapticlod::station
